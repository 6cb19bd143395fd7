"""What rays from a viewpoint meet first in a city: triangles, and before any is asked for, the sky.

``hits`` says what a caster is and what it finds. There are three that agree: ``brute_force`` tests every triangle and is what
the others are held against, ``grid`` puts the triangles into the cells of a regular grid, through which ``grid_caster`` walks,
and ``embree`` hands them to Embree; ``casters`` makes one. They share how a ray meets a triangle (``ray_triangle``), which of
coincident faces is hit (``coincident``), where rays go through what they meet (``see_through``) and how rays are shared out to
threads (``shares``). ``horizon_map`` tells, from the ``height_field`` of a city, which directions see only sky, so that no ray
is cast there.
"""
