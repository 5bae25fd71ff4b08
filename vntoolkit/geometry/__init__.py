"""The objects that flow between the stages: cameras, maps, meshes, moving meshes, skeletons.

`Camera` projects points x in the camera frame (x right, y down, z forward) to pixels (u, v): u = π(K x).
`NormalMap` and `DepthMap` hold one normal n, one depth z a pixel, with a mask. `Mesh` is vertices and
faces, `MeshSequence` the same faces with vertices in every frame, `Motion` a `Skeleton` with rotations in
every frame. Transforms are named `target_from_source` (`RigidTransform`, `Similarity`), points
`x_in_frame`.

`slope_grid` states for every pixel which slopes of depth its normal asks for; integration and shadows
share it. Open3D and pymeshlab get copies: `Mesh.to_open3d`, `Mesh.to_pymeshlab` and back.
"""
