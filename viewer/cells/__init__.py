"""Layers of cells in memory: ``loaded_cell`` reads one, ``layer_atlas`` packs its pictures.

``cell_cache`` keeps cells, bounded in bytes, and loads those ahead in a background thread; ``scene_cache`` makes one for
scenes.
"""
