"""Depth to meshes and point clouds: one vertex a valid pixel, x = z K⁻¹ (u, v, 1)ᵀ; at rims, between pixels.

`surface` makes the triangles between neighbouring pixels, and none across a step of depth. `clean` asks
pymeshlab to remove small pieces, close small holes and reduce triangles. `Mesh` and `PointCloud` are what
comes out.
"""
