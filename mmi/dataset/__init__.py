"""The dataset on disk: written whole or not at all, checked when read.

``folder`` is the folder that a build writes into, ``reading`` an open dataset; ``cell_files`` turns a cell's impostor into
OpenEXR and glTF and back, ``city_files`` does so for what cells share; ``glb`` is the container.
"""
