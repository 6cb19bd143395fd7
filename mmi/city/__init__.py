"""The city as a value: objects of prisms or meshes, streets, terrain.

``model`` has :class:`~mmi.city.model.City`; ``terrain`` the ground; ``long_objects`` cuts what is too long; ``codec`` turns a
city into JSON and back; ``triangulate`` and ``welding`` are geometry that reading, appearance and writing share.
"""
