"""Synthetic captures with ground truth; shares no code with the stages that are tested on them.

A `Scene` is surfaces that move, a camera and `lights`; `render` casts a ray through every pixel and shades
it by equations 1 to 3: r = Σ_k ∫ E_k(λ) R(λ) S(λ) dλ (l_k · n) v_k, with lamps E, reflectance R, sensor S,
visibility v (`image_formation`, `shading`). `nuisances` add what a real camera does: noise, Bayer mosaic,
blur, near lamps, gloss; each can be turned off alone. Scenes: `garment/`, `head/`, `rigid/`, `spandex`.
"""
