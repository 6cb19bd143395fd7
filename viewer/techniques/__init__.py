"""Ways to draw a city, as views in and plans out: ``geometry`` and ``layered``, by name in the ``catalogue``."""
