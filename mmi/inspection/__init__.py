"""Plots of what a build did and why: maps, event graphs, layer sheets, histograms.

``inspect`` writes them for a dataset; ``maps`` and ``layer_sheets`` draw, ``figures`` is the style that they share.
"""
