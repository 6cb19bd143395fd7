"""Where a viewer goes: tours along the streets (``tour``), random views in cells (``random_views``).

Recorded walks are values and files of :mod:`mmi.walks`.
"""
