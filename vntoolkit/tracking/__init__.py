"""Registration: one template mesh through all frames (brostow2011, Section V).

Published: optical flow between the normal maps of neighbouring frames moves the vertices (equations 5 and
6, `flow`), and a regulariser keeps them a surface (equation 7, `regularisers`: similar translations,
Laplacian coordinates; Open3D's deformation beside them). Seams cut what may slide.

Default: every frame is registered to the template itself, so that errors do not add up. `SurfaceTracker`
predicts, `registration` compares relief and paint with the running template band by band, `outline` and
`edge_prior` add what the outline and the surface's own lengths tell. Each is a `Factor` of the nodes'
displacements d: an information matrix A and a right-hand side b. `lattice_system` solves Σ A d = Σ b once
a step; `fit_errors` gives the standard deviation of d. `TrackingTemplate` goes in, `TrackedFrame` comes
out.
"""
