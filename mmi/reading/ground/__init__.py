"""The ground: rasters, points and TINs (``relief``), what a model or a file says of it (``ground``).

``open_space`` makes paths through open space where a model has no streets.
"""
