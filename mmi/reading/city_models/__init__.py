"""City models with meanings: CityJSON and CityGML, which say what is a building, a part of one, a roof or the ground.

``faces`` turns polygons of both into meshes, ``tiles`` joins files to one model, ``zipped`` unpacks them. What has no such
meanings, and what becomes of all models, is in ``models``.
"""
