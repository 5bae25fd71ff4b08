"""Reading and writing maps, meshes and scenes in the formats of other tools."""
