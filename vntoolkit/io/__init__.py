"""Floor 2, files in and out: captures, maps, meshes, rigs, motion; the one stage that touches disk."""
