"""Depth textures turned into meshes as coarse as their error may be.

``grid_mesh`` cuts a picture into rectangles, ``triangulation`` into triangles, ``tears`` says where surfaces share no vertex;
``displacement`` bounds how far a mesh is off; ``ordering`` finds the triangles that need captured depths.
"""
