"""Which lamp reaches which pixel, and the normal where one does not (brostow2011, Section VI).

Symbols: c_k is lamp k's contribution to the colour r, ρ the albedo, l_k · n the cosine. Lamp k is missing
where c_k is smaller than ρ (l_k · n) by more than other surfaces' light explains. Labels hold one bit a lamp.

`ShadowDetector` is the door to labels: `robust` compares the contributions with a surface, again and again;
`graph_cut` labels by the cheapest cut; `detector` holds the published way by edges. `recover_normals` is
the door to normals: `roots` are the two that two lamps leave, `initialisation` starts from them, `surface`
solves for one depth whose slopes satisfy whichever lamps arrive, and `albedo` continues ρ into the shadow.
`lamp_directions` tells the lamps' directions from the colours of shadows.
"""
