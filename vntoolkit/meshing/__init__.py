"""Floor 2, depth to meshes and point clouds."""
