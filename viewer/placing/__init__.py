"""Automatic image placement (Aliaga & Lastra 1999, section 3): which parts of a model are replaced by images seen from which
points, so that no view draws more triangles than a budget.

Nothing here draws, and nothing knows how images look.
"""
