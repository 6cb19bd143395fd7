"""What every reader and writer of glTF 2.0 shares: the container, buffer views, accessors and the specification's numbers.

``container`` puts a binary file together and takes it apart, ``writing`` collects typed arrays in buffer views, ``reading``
gets them back with every size checked, ``codes`` names the numbers. What a file means is the business of those who call:
``mmi.dataset.glb`` (datasets), ``mmi.writing.gltf_writer`` (cities) and ``mmi.reading.models.gltf_reader`` (anybody's files).
"""
