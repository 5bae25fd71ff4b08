"""Maps, meshes and scenes on disk, in the forms that other tools read."""
