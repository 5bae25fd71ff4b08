"""Floor 2, integration: normal maps become depth maps.

`integrate.DepthIntegrator` is the door. Behind it every integrator is the same idea: normals give slopes
(`slopes`), slopes give the depth difference that each edge between neighbouring pixels should have
(`edges`), and a solver finds the depth whose differences fit best. The solvers differ in which edges
count and how much:

- `poisson`: all of them, equally, on a full rectangle (cosine transform, and Fourier for comparison); or
  those inside a mask, weighted by confidence (conjugate gradients);
- `discontinuity`: those whose residual the errors of the normals explain (iteratively reweighted, by the
  same conjugate gradients); all of them where none is larger.
"""
