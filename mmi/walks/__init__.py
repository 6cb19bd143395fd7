"""Recorded walks (``walk``): where a viewer is, and where it looks, at any time; files of them are in ``schemas/walk.json``.

Builds choose cells by them, and viewers follow them.
"""
