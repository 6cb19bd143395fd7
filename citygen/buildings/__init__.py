"""What stands on lots: ``development`` decides footprints and storeys, ``objects`` makes objects of them.

``houses`` builds a house from ``walls``, ``roofs`` and ``trims``; ``church`` is the landmark.
"""
