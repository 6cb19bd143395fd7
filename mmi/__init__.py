"""Multi-mesh impostors: city + streets -> layers of textured depth meshes with a bounded error, on disk."""
