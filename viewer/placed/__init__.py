"""Placed images that are there: what was found for which model and display, the folder that holds it, images in memory.

``viewer.making`` writes such folders, ``viewer.techniques.placed_images`` walks with them.
"""
