"""3D models: glTF, OBJ, PLY and OFF (``polygon_files``), and STL (``mesh_files``), each format a file.

``model_city`` makes a city of what they hold, and of CityJSON and CityGML, which ``city_models`` reads; ``objects_from_meshes``
finds the solid core of a mesh, ``triangle_soup`` takes a mesh without objects apart, ``needles`` mends geometry.
"""
