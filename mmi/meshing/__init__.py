"""Depth textures turned into meshes as coarse as their error may be.

``grid_mesh`` cuts a picture into rectangles, ``triangulation`` into triangles; ``displacement`` measures how far a mesh is off;
``ordering`` finds the triangles that need captured depths.
"""
