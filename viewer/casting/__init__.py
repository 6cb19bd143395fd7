"""Far-field ray casting with a panoramic image cache (Wimmer, Giegl & Schmalstieg 1998): what a frame's open pixels show.

Nothing here draws. ``FarField`` is what is made once of a city: who is near, rays, horizon. ``Panorama`` is what one viewer has
cast so far. ``cast_frame`` goes from the depths of what was drawn to the surfaces of all other pixels.
"""
