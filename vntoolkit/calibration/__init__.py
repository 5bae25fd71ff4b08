"""M from pairs of normal and colour (equation 4: r = M n + a), and the quality of the fit.

What is filmed gives the pairs: a `board`, whose pattern gives the pose and whose hole shows the material
(Section III-A of brostow2011); a ball, whose outline gives the normal at every pixel (`sphere`), under all
lamps or each alone (`ball_lamps`); a bare head that turns (`head/`). `lights` needs none: it computes M from
lamps whose directions and colours are known. `fit` solves equation 4 for all of them and leaves out shadow,
gloss and wrong pairs; `varying` lets M change over the picture, as near lamps make it.

Each returns a result that holds a `LightResponse`, its residual in degrees, and what it was fitted on.
"""
