"""Floor 2, normals to depth."""
