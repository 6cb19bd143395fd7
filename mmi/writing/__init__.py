"""Cities as files for others: CityJSON 2.0 and glTF, and checks of what was written.

``cityjson_writer`` (with ``cityjson_geometry``) and ``gltf_writer`` write; ``cityjson_checks`` and ``solids`` say what is wrong
with a city or a solid in the words of val3dity.
"""
