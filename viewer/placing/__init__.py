"""Automatic image placement (Aliaga & Lastra 1999): which parts of a model are replaced by images seen from which points, so
that no view draws more triangles than a budget; and those images, layered and warped.

Nothing here draws.
"""
