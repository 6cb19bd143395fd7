"""Whereabouts have moved to :mod:`mmi.cells.whereabouts`, since builds ask them as well; this goes when its last user has."""

from mmi.cells.whereabouts import HYSTERESIS, Whereabouts

__all__ = ["HYSTERESIS", "Whereabouts"]
