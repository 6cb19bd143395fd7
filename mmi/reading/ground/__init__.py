"""The ground: rasters, points and TINs (``relief``), what a model or file says (``ground``), a fit of feet (``smooth_fit``).

``open_space`` makes paths through open space where a city has no streets, along the ``skeleton`` between its walls.
"""
