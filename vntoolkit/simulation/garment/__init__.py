"""A knitted sweater on a dancer: its sewing pattern and a position-based cloth solver (macklin2016).

`ClothSolver` moves particles under constraints C(x) = 0 with compliance in small steps; `sweater` is the
scene.
"""
