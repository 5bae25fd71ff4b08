"""What a result folder holds beside its maps: the manifest, the frame log, moving meshes, seams."""
