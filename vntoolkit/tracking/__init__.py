"""Floor 2, one moving mesh from a sequence of normal and depth maps."""
