"""Solids that generated objects are put together from (``solids``), and the pictures on them (``textures``)."""
