"""Cities as files for others: CityJSON 2.0 (``cityjson_writer``, with ``cityjson_geometry``) and glTF (``gltf_writer``).

What is written goes to disk whole or not at all, and the same city gives the same bytes.
"""
