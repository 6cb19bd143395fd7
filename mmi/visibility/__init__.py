"""What a cell may see (paper sections 5.2 and 5.3): selections of a city's objects, narrowed stage by stage.

``selection`` has the pipeline; ``horizon`` the conservative sweep (its kernel in ``horizon_sweep``), ``item_buffer`` the
paper's way; ``walls`` the walls as arrays, ``visible_walls`` what of them may be seen and from where, ``cell_outline``
viewpoints.
"""
