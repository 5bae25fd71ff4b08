"""M corrected until the frames agree on every normal, and the normals with the positions of stereo.

An error of M, the same in all frames, bends the shape in patterns that are known.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import null_space

from vntoolkit.arrays import FloatArray, IntArray, Points
from vntoolkit.calibration.head.positions import PositionSolver, areas
from vntoolkit.calibration.head.samples import SkinColours
from vntoolkit.calibration.head.skin import (
    LEAST_RESIDUAL,
    RIDGE,
    SkinLight,
    SkinNormals,
    parts_of,
    rows_at,
)
from vntoolkit.geometry.mesh import Mesh
from vntoolkit.photometry.response import LightResponse
from vntoolkit.spread import robust_deviation

_ROBUST_ROUNDS = 6
# M's scale is open, and stays as it is
_FREE = null_space(np.append(np.eye(3), np.zeros(3)).reshape(1, -1))
_FIRST_ERROR = 0.05  # standard deviation of an entry of E for the first M
_NEARNESS = 0.2  # of lamps that are five of the head's diagonals away
_REGION = 1 / 6  # of the diagonal: stereo errs alike within such cubes
_LOOSE = 2.0  # of the diagonal: where normals are to show their errors, stereo holds only the mesh's place


def corrected_light(
    light: SkinLight,
    first: LightResponse,
    colours: SkinColours,
    skin: SkinNormals,
    stereo: Mesh,
    side: float,
) -> SkinLight:
    """Return the light whose normals agree best between the frames, and with the positions of stereo.

    An error of M that all frames follow shows only in the shape: wrong normals move positions off stereo's by
    more than its noise, in patterns that are known. Both are linear in the errors; patches of skin count as
    one observation. Slopes of stereo say less: windows flatten what is smaller than them. What no model holds
    errs over whole regions alike, and that tells how sure the errors are: where they are not, M stays near
    the first and lamps stay far.
    """
    response = light.response
    solver = PositionSolver(stereo.vertices, stereo.faces, skin, _LOOSE * stereo.diagonal)
    surface = stereo.with_vertices(solver.positions())
    assert surface.normals is not None
    area = areas(surface.vertices, surface.faces)
    share = np.where(skin.known, np.minimum(area / side**2, 1.0), 0.0)
    cubes = np.floor(surface.vertices / (_REGION * surface.diagonal)).astype(np.int64)
    region = np.unique(cubes, axis=0, return_inverse=True)[1].ravel()
    errors = light_errors(colours, skin, light, share, region)
    patterns = solver.moved_by(-errors.turned, surface) @ _FREE
    moved = ((surface.vertices - solver.stereo) * surface.normals).sum(axis=1)
    systems, rights = _FREE.T @ errors.system @ _FREE, errors.right @ _FREE
    agreement, right = systems.sum(axis=0), rights.sum(axis=0)
    back = np.linalg.solve(response.matrix, first.matrix)
    back = 3.0 * back / np.trace(back) - np.eye(3)
    back = np.append(back.ravel(), -light.nearness)
    spread = np.append(np.full(9, _FIRST_ERROR), np.full(3, _NEARNESS / surface.diagonal))
    near = _FREE.T @ (_FREE / spread[:, None] ** 2)
    back = _FREE.T @ (back / spread**2)
    step = np.zeros(_FREE.shape[1])
    for _ in range(_ROBUST_ROUNDS):
        off = moved + patterns @ step
        noise = robust_deviation(off[skin.known])
        weight = share / (1.0 + np.square(off / (2.0 * noise))) ** 2 / noise**2
        weighted = patterns * weight[:, None]
        system = agreement + patterns.T @ weighted
        step = np.linalg.solve(system + near, right - weighted.T @ moved + back)
    scores = np.stack([np.bincount(region, column) for column in (weighted * off[:, None]).T], axis=1)
    scores += systems @ step - rights
    information = system @ np.linalg.solve(agreement + scores.T @ scores, system)  # 1 / variance
    step = np.linalg.solve(information + near, information @ step + back)
    entries = _FREE @ step
    matrix = response.matrix @ (np.eye(3) + entries[:9].reshape(3, 3))
    scale = np.linalg.norm(response.matrix) / np.linalg.norm(matrix)
    return SkinLight(
        response=replace(response, matrix=scale * matrix),
        nearness=np.maximum(light.nearness + entries[9:], 0.0),
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class LightErrors:
    """What errors of the light do to the solution.

    Of 12 errors, the first nine are those of E, row by row, where M (I + E) is right, then three of nearness.
    turned: (n, 3, 12), normals less those by the right light, per unit of error. system: (r, 12, 12), right:
    (r, 12), the normal equations for the errors of what the frames' disagreement says, by region. They leave
    open what every b can follow: E that commutes with the turn, such as the scale along its axis.
    """

    turned: FloatArray
    system: FloatArray
    right: FloatArray


def light_errors(
    colours: SkinColours, skin: SkinNormals, light: SkinLight, share: FloatArray, region: IntArray
) -> LightErrors:
    """Differentiate the solutions by the light.

    share: (n,) independent observations that a vertex stands for. region: (n,) its region, 0 to r − 1.
    """
    regions = int(region.max()) + 1
    turned, system, right = [], np.zeros((regions, 12, 12)), np.zeros((regions, 12))
    for part, rgb, _ in parts_of(colours, light):
        b = np.where(skin.known[part, None], skin.scaled[part], 0.0)
        weight = np.where(skin.known[part], skin.weight[:, part], 0.0)
        slope, rows = _slopes(colours, light, part, b), rows_at(colours, light, part)[0]
        left = rgb - (rows @ b[:, :, None])[..., 0]
        squares, brightness = (np.einsum("fn,fnc->n", weight, each**2) for each in (left, rgb))
        variance = np.maximum(squares, LEAST_RESIDUAL**2 * brightness) / np.maximum(
            3.0 * weight.sum(axis=0), 1e-9
        )
        own = np.einsum("fn,fnck,fncl->nkl", weight, rows, rows, optimize=True)
        own += (RIDGE * np.trace(own, axis1=1, axis2=2) + 1e-12)[:, None, None] * np.eye(3)
        mixed = np.einsum("fn,fnck,fnce->nke", weight, rows, slope, optimize=True)
        followed = np.linalg.solve(own, mixed)
        turned.append(followed / np.maximum(np.linalg.norm(b, axis=1), 1e-12)[:, None, None])
        counted = share[part] / np.maximum(variance, 1e-12)
        both = np.einsum("fn,fnce,fncg->neg", weight, slope, slope, optimize=True)
        kept = both - mixed.transpose(0, 2, 1) @ followed
        np.add.at(system, region[part], counted[:, None, None] * kept)
        off = np.einsum("fn,fnce,fnc->ne", weight, slope, left, optimize=True)
        np.add.at(right, region[part], counted[:, None] * off)
    turns = np.concatenate(turned)
    along = np.einsum("ni,nik->nk", skin.normals, turns)
    turns -= skin.normals[:, :, None] * along[:, None, :]
    return LightErrors(turned=turns, system=system, right=right)


def _slopes(colours: SkinColours, light: SkinLight, part: slice, b: Points) -> FloatArray:
    """Return the change of the colours (f, n, 3, 12) by the errors of the light."""
    change = rows_at(colours, light, part)[1]
    seen = b @ colours.rotations.transpose(0, 2, 1)  # (f, n, 3), camera frame
    by_matrix = np.asarray(light.response.matrix)[:, :, None] * seen[:, :, None, None]
    by_nearness = np.eye(3) * (change @ b[:, :, None])
    return np.concatenate([by_matrix.reshape(*seen.shape, 9), by_nearness], axis=-1)
