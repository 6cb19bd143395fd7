"""How wrong a picture is: errors of a view (``view_errors``), the disocclusion mask (``disocclusion``), summaries.

``judge`` scores techniques against the geometry, drawn by the same renderer.
"""
