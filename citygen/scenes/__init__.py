"""Scenes of the other papers: a ``forest``, a ``living_room``, a plant of ``pipes``, with ``paths`` through them."""
