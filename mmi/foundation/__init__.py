"""What everything stands on and nothing of the paper: it imports no other package of the project.

Errors and the camera (``errors``, ``camera``), chords between points of one capture ray (``ray_chords``), the thickness of a
region (``thickness``), pictures on shelves (``shelves``), sRGB (``srgb``), files that are whole or not there
(``whole_files``), JSON and fingerprints (``json_forms``), functions from outside the package (``plug_ins``), compiled functions
(``kernels``), how far long work has come and how long it took (``progress``), processes.
"""
