"""How walls look of which a city's files say nothing.

This module imports nothing, so that a program can check what it was told before it loads anything that takes time.
"""

__all__ = ["FACADE_KINDS"]

FACADE_KINDS = ("painted", "plain")
"""Painted with windows, doors and shops, or plain: of one colour a building, which says that nothing is known."""
