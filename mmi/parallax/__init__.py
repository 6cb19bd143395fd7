"""How far things part in the picture while the viewer moves in its cell: weights, in radians.

``ray_weights`` has the tight weights, of points on one capture ray; ``paper_weights`` the paper's (section 4.2), from
``viewing_angle`` and ``critical_zone``; ``texels`` says how fine textures need to be.
"""
