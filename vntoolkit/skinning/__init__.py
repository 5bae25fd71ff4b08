"""A captured moving garment on an animated skeleton (brostow2011, equation 8).

Equation 8 moves a vertex by a weighted mean of its joints' transforms: x' = Σ_j w_j T_j x. `anatomy` names
trunk, arms and legs of a `Skeleton`; `sleeves` finds those of the garment; `fitting` hangs one on the
other; `attachment` and `weights` give w; `blending` applies them (linear, or dual quaternions);
`alignment` takes the captured motion of every frame into the pose of attachment; `clock` matches the two
frame rates; `stretch` draws together what stretches too far, and `findings` says what cannot follow.
"""
