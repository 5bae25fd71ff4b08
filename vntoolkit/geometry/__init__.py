"""Floor 1, the objects that flow: transforms, cameras, maps, point clouds, meshes, moving meshes."""
