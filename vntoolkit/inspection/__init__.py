"""Floor 2, inspection: what depth and normals say of a surface's dents, print and texture.

- `heights`: distances from the plane that fits a surface best, and wavelengths of them (ISO 16610).
- `curvature`: mean and Gaussian curvature, from the normals.
- `roughness`: areal height parameters by ISO 25178, and files of other programs, through `surfalize`.
"""
