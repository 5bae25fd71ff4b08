"""Does the surface reflect the lamps as a mirror does, if dimly? Highlights pull normals towards the lamps.

A highlight adds the lamp's colour where the normal is nearly halfway between the directions to the lamp and
to the camera. M⁻¹(r − a) grows there by a length that M, the lamps and the width of the lobe foretell. The
log lengths are regressed on it, beside all that depends on the direction or the place slowly: faults of M,
light from elsewhere, vignetting. The slope is how strong the lobe is, as a share of the matte light.
"""

from __future__ import annotations

import numpy as np

from vntoolkit.arrays import FloatArray
from vntoolkit.diagnosis.evidence import Evidence, lengths_of
from vntoolkit.diagnosis.finding import Finding, Level, certainty_from_z
from vntoolkit.diagnosis.surface_pixels import (
    SurfacePixels,
    regress_lengths,
    spread_of_lengths,
    surface_pixels,
)

_FEWEST_PIXELS = 400
_ROUNDS = 4
_EXPONENT = 30  # of the lobe: exponents of 8 to 100 are found with it
_Z = 8.0  # photographs of plaster and faces, where parts of a subject light each other, reach 6.9
_LEAST = 0.03  # of the matte light; matte renderings reach 0.015
_PAINTED = 0.12  # spread of log lengths: the glossiest renderings have 0.05, a tartan 0.2
_TAIL, _NOTED_DEG = 95.0, 2.0


def check_gloss(evidence: Evidence) -> list[Finding]:
    """Find highlights of the lamps on the subject."""
    pixels = surface_pixels(evidence, lambda k, _: evidence.surface[k])
    if len(pixels) < _FEWEST_PIXELS:
        return []
    scaled = pixels.scaled_normals(pixels.rgb)
    lengths = np.maximum(lengths_of(scaled), 1e-12)
    normals = scaled / lengths[:, None]
    if spread_of_lengths(scaled, pixels.frames) > _PAINTED:
        return []
    added = _highlights(evidence, pixels, normals)
    (x, y, z), (u, v) = normals.T, pixels.positions.T
    slowly = [x, y, x * x - z * z, y * y - z * z, x * y, x * z, y * z, u, v, u * u, v * v, u * v]
    longer = (added * normals).sum(axis=1)
    found = regress_lengths(np.column_stack([longer, *slowly]), np.log(lengths), pixels, _ROUNDS)
    if found is None:
        return []
    strength, error = float(found.slopes[0]), max(float(found.errors[0]), 1e-3)
    if strength < max(_LEAST, _Z * error):
        return []
    turns = strength * lengths_of(added - longer[:, None] * normals)
    turn_deg = float(np.degrees(np.percentile(turns, _TAIL)))
    return [
        Finding(
            check="gloss",
            level=Level.WARNING if turn_deg > _NOTED_DEG else Level.NOTE,
            problem="the surface is glossy: highlights pull normals towards the lamps, one in twenty by "
            f"{turn_deg:.0f} degrees and more",
            measured=f"highlights of {strength:.0%} ± {error:.1%} of the matte light",
            expected=f"less than {_LEAST:.0%}",
            remedy="powder the surface, or put crossed polarising filters before lamps and camera",
            certainty=certainty_from_z(strength / error),
        )
    ]


def _highlights(evidence: Evidence, pixels: SurfacePixels, normals: FloatArray) -> FloatArray:
    """Return what lobes of strength 1 add to M⁻¹(r − a) over the albedo, (n, 3)."""
    response, camera = evidence.rig.response, evidence.rig.camera
    view = np.tile([0.0, 0.0, -1.0], (len(normals), 1))
    if camera.is_perspective:
        half = max(camera.width, camera.height) / 2
        view[:, :2] = -pixels.positions * half / camera.matrix[[0, 1], [0, 1]]
        view /= lengths_of(view)[:, None]
    halfway = response.light_directions + view[:, None]  # (n, 3 lamps, 3)
    cosines = np.einsum("ni,nki->nk", normals, halfway) / np.linalg.norm(halfway, axis=2)
    lobes = np.maximum(cosines, 0.0) ** _EXPONENT
    strengths = np.linalg.norm(response.lights, axis=1)
    return np.asarray((lobes * strengths) @ np.linalg.inv(response.lights).T)
