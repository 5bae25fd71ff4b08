"""Whether footage, rig and result can be trusted: checks that name a fault, a number and a remedy.

`Evidence` is what the checks look at: a few frames averaged down, the mask, and the rig they are read with.
Most checks rest on two facts. On one material the length of M⁻¹ (r − a) is the albedo, whatever the
direction n (equation 1). And the slopes (p, q) of a surface agree: ∂p/∂v = ∂q/∂u.

`header_checks`, `rig_checks`, `press_checks` and `gel_checks` test what a file states; `steps`, `flicker`
and `white_balance` what changes while filming; `transfer_match`, `added_light`, `lamp_nearness` and
`sharpness` how the light became colour; `surface_match`, `axes` and `outline` whether the normals are a
surface's; `subject` and `backdrop` where one is. `inspection` asks them all. Each returns `Finding`s, whose
words stand in `table`; `finding.judge` decides, the same for every verb, whether a run goes on.
"""
