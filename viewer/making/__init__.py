"""Making placed images: pictures by the renderer, merged and kept in a folder by worker processes, resumable at any moment.

Gives out ``place_images`` and what it is told.
"""
