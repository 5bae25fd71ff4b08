"""Floor 2, reading and writing files: captures, maps, meshes, rigs, motion, results."""
