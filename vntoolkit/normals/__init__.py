"""Colour to normals: n ∝ M⁻¹ (r − a), the inverse of equation 1, and the error to expect of it.

`inversion` gives a `NormalMap` with a weight a pixel: the length of M⁻¹ (r − a) is the albedo, and a
length that is not the expected one speaks of shadow, gloss or another paint. `expected_error` states the
angle that nine of ten normals stay within, from what `frame_evidence` measures in the frame itself (noise,
lost relief, a wrong rig). `lost_detail` foretells the relief that the camera has averaged away.
`photometric_stereo` is the classical method: many photographs, one white lamp each, least squares a pixel.
"""
