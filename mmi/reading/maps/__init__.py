"""Footprints and streets: OpenStreetMap (``osm``), what GDAL reads (``footprints``), SUMO networks (``sumo``).

``heights`` infers heights, ``repair`` mends outlines, ``buildings`` makes objects and ``streets`` the street graph of them.
"""
