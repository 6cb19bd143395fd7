"""Answers to what somebody asks of a view: what stands at a pixel and why (``picking``), where all objects are (``city_map``),
how wrong the picture is at its worst (``worst_region``). What takes long is found out in the background.
"""
