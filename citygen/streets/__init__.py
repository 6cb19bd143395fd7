"""The plan of a town: ``relief``, street ``networks``, ``subdivision`` into blocks, and ``blocks`` into lots.

``planar`` and ``ragged`` are the data structures: a street plan in the making, and convex polygons by the hundred thousand.
"""
