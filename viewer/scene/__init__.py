"""A dataset opened for walking: ``scene`` is the city's geometry and its cells.

``follower`` follows a viewer from cell to cell, ``frustum`` tells what a view may show.
"""
