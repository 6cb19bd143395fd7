"""How far things part in the picture while the viewer moves in its cell: weights, in radians.

``ray_weights`` has the tight weights between two objects, of points on one capture ray, and ``self_parallax`` those within
one object; both rest on ``ray_angles``. ``paper_weights`` has the paper's (section 4.2), between objects that meet each
other's ``critical_zone``. ``from_anywhere`` bounds how far two points of one ray part for all viewers of a cell. ``texels``
says how fine textures need to be.
"""
