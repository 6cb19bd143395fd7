"""Where a viewer may be: streets as centre lines (``centre_lines``), cut into viewing cells (``viewing_cells``).

A :class:`~mmi.cells.viewing_cells.ViewingCell` is a straight stretch of a street with a half width and a band of eye heights.
``whereabouts`` finds the cell of a viewpoint, ``choice`` the cells around a place and along a path.
"""
