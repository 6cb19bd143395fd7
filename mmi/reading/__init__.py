"""Files of many kinds become a city: one function, ``read_city.read_city``, and a report of what was mended.

``maps`` reads footprints and streets, ``models`` and ``city_models`` read 3D models, ``ground`` finds the terrain.
``coordinates`` brings all of it to a local metric frame, ``pictures`` keeps textures, ``raw_layers`` has the values in
between, ``report`` counts what was kept, mended and left out.
"""
