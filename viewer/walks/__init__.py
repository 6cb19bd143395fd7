"""Where a viewer goes: recorded walks (``walk``), tours along the streets (``tour``), random views in cells
(``random_views``).
"""
