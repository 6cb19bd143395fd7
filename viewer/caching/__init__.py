"""The three-dimensional image cache (Schaufler & Stürzlinger 1996): a hierarchy of boxes over all of a scene's triangles.

Nothing here draws.
"""
