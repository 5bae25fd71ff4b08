"""M from a bare head that turns before the lamps (brostow2011, Section IV).

The stages, in order: `tracks` of skin points → `poses` of the head (`factorisation` or `mapping` starts
them, `colmap` adjusts them; `sift` replaces tracks) → `silhouettes` → `hull`, the volume inside all of them
→ `stereo`, `patches` and `rims` → `shape`, one mesh → `samples`, pairs of approximate normal and colour →
`light`, M by random samples of three → `refinement`: normals of all frames (`skin`) bend the mesh
(`positions`), which corrects M (`light_correction`), each by its measured noise (`shape_noise`).

Objects: tracks -> `HeadMotion` -> `DistanceGrid` -> `Mesh` -> `HeadSamples` -> `HeadLight` -> `RefinedHead`.
Frames: the head's own, in which the camera turns about it; lengths are in units of the poses' scale.
"""
