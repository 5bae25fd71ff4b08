"""What colour profiles state: the curve of an ICC profile, and primaries other than BT.709's."""

import struct

import numpy as np

from vntoolkit.arrays import FloatArray, Matrix3
from vntoolkit.io.footage.stated import BT709
from vntoolkit.photometry.transfer import Transfer, linear_from_encoded

_SAME_CURVE = 0.5 / 255  # of full scale; half a level of 8 bits
_CURVES = ("linear", "srgb", "bt709")
_SAME_CHROMATICITY = 1e-3  # tags are rounded to three or four digits
# `lam1985`: the responses of cones, in which one white is scaled to another
_BRADFORD = np.array([[0.8951, 0.2664, -0.1614], [-0.7502, 1.7135, 0.0367], [0.0389, -0.0685, 1.0296]])


# Curves of ICC profiles (ICC.1:2022, 10.6 and 10.18).


def curve_of_profile(profile: bytes) -> str:
    """Return the transfer curve of an ICC profile as `Transfer` reads it, else words for it."""
    codes = np.linspace(0.0, 1.0, 256)
    try:
        count = struct.unpack_from(">I", profile, 128)[0]
        entries = (struct.unpack_from(">4sII", profile, 132 + 12 * k) for k in range(min(count, 100)))
        tags = {name: profile[at : at + size] for name, at, size in entries}
        wanted = [b"kTRC"] if b"kTRC" in tags else [b"rTRC", b"gTRC", b"bTRC"]
        lights = [_light_of_icc_curve(tags[name], codes) for name in wanted]
    except (struct.error, KeyError, ValueError, IndexError):
        return "of an ICC profile without one of its own"
    return curve_of_lights(codes, np.array(lights)) or "of an ICC profile, unlike any known one"


def _light_of_icc_curve(tag: bytes, codes: FloatArray) -> FloatArray:
    """Return linear light of codes 0 to 1 by a `curv` or `para` element."""
    if tag[:4] == b"curv":
        count = struct.unpack_from(">I", tag, 8)[0]
        table = np.array(struct.unpack_from(f">{count}H", tag, 12), np.float64)
        if count < 2:
            return codes ** (table[0] / 256 if count else 1.0)
        return np.interp(codes, np.linspace(0, 1, count), table / 65535)
    kind = struct.unpack_from(">H", tag, 8)[0]
    g, *p = (n / 65536 for n in struct.unpack_from(f">{(1, 3, 4, 5, 7)[kind]}i", tag, 12))
    if kind == 0:
        return codes**g
    a, b, *rest = p
    if kind < 3:
        cut, slope, above, below = -b / a, 0.0, sum(rest), sum(rest)
    else:
        slope, cut, above, below = (*rest, 0.0, 0.0)[:4]
    return np.where(codes >= cut, np.maximum(a * codes + b, 0) ** g + above, slope * codes + below)


def curve_of_lights(codes: FloatArray, lights: FloatArray) -> str:
    """Return the curve, as `Transfer` reads it, that takes codes to light; empty for none that is known.

    lights: (channels, codes); empty, too, where these differ.
    """
    if np.ptp(lights, axis=0).max() > _SAME_CURVE:
        return ""
    light = lights.mean(axis=0)
    middle = len(codes) // 2
    names = list(_CURVES)
    if 0 < light[middle] < 1:
        exponent = float(np.log(light[middle]) / np.log(codes[middle]))
        if 0.1 <= exponent <= 10:
            names.append(f"gamma:{exponent:.4g}")
    errors = [
        float(np.abs(linear_from_encoded(codes, Transfer.from_text(name)) - light).max()) for name in names
    ]
    best = int(np.argmin(errors))
    return names[best] if errors[best] <= _SAME_CURVE else ""


# Primaries. The response to three lamps is that of the file's own red, green and blue, whichever these are.
# Renders of one scene come as OpenEXR of several: they go to BT.709's, the format's own where none is stated.


def bt709_from(chromaticities: tuple[float, ...]) -> Matrix3 | None:
    """Return what takes linear RGB of other primaries to BT.709's, white to white; None for BT.709's own."""
    if np.allclose(chromaticities, BT709, atol=_SAME_CHROMATICITY):
        return None
    own, to = _cones_from_rgb(chromaticities), _cones_from_rgb(BT709)
    return np.linalg.inv(to) @ np.diag(to.sum(axis=1) / own.sum(axis=1)) @ own


def _cones_from_rgb(chromaticities: tuple[float, ...]) -> Matrix3:
    """Return (3, 3): what the cones see of each primary, whose sum is a white of luminance 1."""
    x, y = np.reshape(chromaticities, (4, 2)).T
    xyz = np.stack([x / y, np.ones(4), (1 - x - y) / y])  # of luminance 1 each
    return _BRADFORD @ (xyz[:, :3] * np.linalg.solve(xyz[:, :3], xyz[:, 3]))
