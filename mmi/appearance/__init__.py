"""What a city looks like: a city in, textured triangles out.

``city_mesh`` makes one mesh and one texture of all objects (``model_surfaces`` of those that came with a mesh);
``ground_mesh`` and ``ground_tiles`` make the ground; ``facades``, ``facade_styles``, ``shading`` and ``texture_atlas`` paint.
"""
