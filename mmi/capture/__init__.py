"""Layers drawn into depth textures (paper section 5.1): the only package that imports pyrender.

``windows`` says which part of which sector, ``renderer`` draws, ``layer_values`` are the results; ``unseen``, ``rims``,
``covered_pieces`` and ``dilation`` decide which texels stay.
"""
