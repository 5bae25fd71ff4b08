"""Several materials on one subject: how much each returns of every lamp, and which pixels are of it.

Under a rig that knows its lamps, a material is three factors ρ_k: r = Σ_k ρ_k c_k (l_k · n) (equation 1
with M = Σ_k ρ_k c_k l_kᵀ). Normals have unit length, which fixes ρ up to the normals' directions.

`search` proposes materials on sampled frames and decides how many there are by description length;
`reflectance` fits ρ of one; `labelling` gives every pixel of every frame its material; `label_moves` and
`mixtures` treat the blurred seams between them; `paint`, `paint_levels` and `pigment` follow colour that
changes inside a material; `grey_paint` doubts the search: one paint of the rig's hue may explain the
footage as well. `relighting` turns a frame into what it would be if the calibration material were
everywhere; then the other stages go on.
"""
