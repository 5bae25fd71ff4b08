"""A tactile sensor: a camera that sees its gel from behind, under coloured lamps.

A gel is compared with itself: d is a pixel's colour less the untouched gel's there. `circles` finds where a
ball touches; `presses` gives normals to its pixels; `fit` fits the response to them (equation 4, with a
correction by colour and place); `response` says what it computes; `inversion` computes it frame by frame,
the drift of the light removed; `dots` fills printed dots; `contact` finds what touches in the depth; `motion`
follows the gel's material by its dots or its texture, and `motion_maps` spreads that over the picture; `pose`
follows the object that touches.

Objects: `Press` -> `PressSamples` -> `GelFit` (a `LightResponse` M and a `GelResponse`) -> `NormalMap`;
`DepthMap` -> `Contact`; `Membrane` -> `MembraneMotion` -> `GelMotion`;
`ObjectPose` -> `TrackedPose`. The files are read in
`pipeline/calibrate_presses.py` and `pipeline/gel.py`.
"""
