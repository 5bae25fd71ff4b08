"""Floor 2, colour to normals, by inverting M or from many single-light photographs."""
