"""Maps, meshes and scenes in the formats of other tools.

One table, suffix → reader and writer, each for maps (EXR, PNG, TIFF, NPZ), meshes (PLY, OBJ), moving
scenes (GLB, USD) and label images (indexed PNG). Sizes are checked from headers before memory is taken.
Axes are flipped here.
"""
