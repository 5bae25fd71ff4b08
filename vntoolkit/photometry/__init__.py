"""Light: how a normal becomes a colour, and a stored value linear light.

Equation 1: r = M n + a, with r the linear RGB of a pixel, M (3, 3), the ambient light a (3,).
`LightResponse` holds M and a, constant or as polynomials of the pixel (`ResponseVariation`); M = Σ_k c_k
l_kᵀ where the colour c_k and the direction l_k of each lamp k are known. `Transfer` is the curve between
stored values and linear light. `Rig` joins camera, response and transfer: all that is calibrated.

`LinearFrame` is a picture in linear RGB with its clipped pixels; labels say which lamps reach a pixel.
`Leveller` turns frames into those of one M where M varies. `GelResponse` is a gel's, from d = r −
r_untouched.
"""
