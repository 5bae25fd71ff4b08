"""What a frame would look like if the calibration material were everywhere.

The light on a pixel is divided by the reflectance of its material, lamp by lamp. In a blurred picture of
several materials it is then weighed (`likeliest_light`). Where a material has a pigment, the pixel's place on
the pigment's line counts.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import prange

from vntoolkit.arrays import FloatArray, Mask, Points
from vntoolkit.materials.likeliest_light import REACH_PX, take_likeliest
from vntoolkit.materials.mixtures import blur_weights, reach_of_blur, room_for, wide_weights
from vntoolkit.materials.pigment import take_without_pigment
from vntoolkit.materials.pixels import MaterialLabels, Seams, near_seams
from vntoolkit.materials.reflectance import lamps_from_response
from vntoolkit.native import njit
from vntoolkit.photometry.frame import LinearFrame
from vntoolkit.photometry.response import LightResponse

_NONE = np.float32(0.0)


def relit(
    frame: LinearFrame,
    response: LightResponse,
    labels: MaterialLabels,
    reflectances: Points,
    pigments: Points | None = None,
    seams: Seams | None = None,
    mask: Mask | None = None,
    box: tuple[slice, slice] | None = None,
) -> LinearFrame:
    """Return the frame as it would be with the calibration material everywhere: r' = Cᵀ (C⁻ᵀ r ∘ 1/ρ).

    labels: (h, w), numbers of the reflectances (m, 3). pigments: (m, 3), the lines of log ρ along which
    materials change, 0 for none. seams: how pixels beside seams are mixtures; without it they are of one
    material. mask: (h, w), the subject, whose pixels tell each other's light and may have pigment; None for
    everywhere. box: rows and columns beyond which the result is 0; None for none. Ambient light falls on the
    material too: it is divided by ρ with the rest.
    """
    values = np.asarray(reflectances, np.float64)
    lamps = lamps_from_response(response, np.zeros(3))
    merge = np.linalg.inv(lamps.split)
    matrices = np.array([merge @ np.diag(1.0 / rho) @ lamps.split for rho in values])
    along = np.zeros_like(values) if pigments is None else np.asarray(pigments, np.float64)
    out = np.empty(frame.rgb.shape, np.float32)
    inside = np.ones(labels.shape, np.bool_) if mask is None else mask
    h, w = labels.shape
    box = box or (slice(0, h), slice(0, w))
    corners = box[0].start, box[0].stop, box[1].start, box[1].stop
    near, done = np.zeros(labels.shape, np.bool_), np.zeros(labels.shape, np.bool_)
    if seams is not None and seams.blur_px > 0.0 and len(values) > 1:
        reach = reach_of_blur(seams.blur_px)
        near[box] = near_seams(np.ascontiguousarray(labels[box]), reach)
        done[box] = True
        if along.any():  # beside seams alone there is no pigment
            done[box] = near[box]
        blur, around = (wide_weights(blur_weights(seams.blur_px, each)) for each in (reach, REACH_PX))
        take_likeliest(
            np.ascontiguousarray(frame.rgb), labels, near, inside,
            tuple(each.astype(np.float32) for each in (lamps.haze, lamps.inverse, lamps.split, merge)),
            values.astype(np.float32), blur, around,
            (np.float32(seams.steps), np.float32(seams.tolerance)), np.asarray(seams.noise, np.float32) ** 2,
            corners, out,
        )  # fmt: skip
        if done[box].all():
            return LinearFrame(rgb=out, clipped=frame.clipped, number=frame.number)
    of_lamps = (lamps.split, lamps.inverse @ lamps.haze)
    of_materials = (along, lamps.inverse / values[:, None], merge / values[:, None])
    _relight(
        np.ascontiguousarray(frame.rgb), labels, matrices.astype(np.float32),
        tuple(each.astype(np.float32) for each in of_lamps),
        tuple(each.astype(np.float32) for each in of_materials), inside, done,
        corners, out,
    )  # fmt: skip
    return LinearFrame(rgb=out, clipped=frame.clipped, number=frame.number)


def colours_of(reflectances: Points, response: LightResponse) -> FloatArray:
    """(m, 3), linear colour 0 to 1 of each material in the light of all three lamps, balanced to white.

    White is the calibration material, or the strongest material where one returns more.
    """
    colours = np.abs(np.linalg.inv(response.contributions_from_rgb).T)
    seen = np.asarray(reflectances) @ colours / colours.sum(axis=0)
    return np.asarray(seen / max(1.0, float(seen.max())))


def box_of(mask: Mask) -> tuple[slice, slice]:
    """Return the rows and the columns that a mask reaches over."""
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    if not len(rows):
        return slice(0, 0), slice(0, 0)
    return slice(int(rows[0]), int(rows[-1]) + 1), slice(int(columns[0]), int(columns[-1]) + 1)


@njit(cache=True, parallel=True, error_model="numpy")
def _relight(
    rgb: Any, labels: Any, matrices: Any, of_lamps: Any, of_materials: Any, inside: Any, done: Any, box: Any,
    out: Any,
) -> None:  # fmt: skip
    """Fill out (h, w, 3) from colours rgb (h, w, 3), all in single precision.

    matrices: (m, 3, 3), from colour to colour. of_lamps: split, and L⁻¹ w. of_materials: the lines of
    pigments, L⁻¹ / ρ, and split's inverse over ρ. inside: (h, w), where pigments count. done: (h, w), pixels
    that stay as they are. box: first and last row, first and last column, the last ones not included; 0
    beyond.
    """
    top, bottom, left, right = box
    for v in prange(len(labels)):
        if top <= v < bottom:
            out[v, :left] = _NONE
            out[v, right:] = _NONE
            _relight_row(
                rgb[v], labels[v], matrices, of_lamps, of_materials, inside[v], done[v], left, right, out[v]
            )
        else:
            out[v] = _NONE


@njit(cache=True, error_model="numpy")
def _relight_row(
    rgb: Any, labels: Any, matrices: Any, of_lamps: Any, of_materials: Any, inside: Any, done: Any,
    begin: int, end: int, out: Any,
) -> None:  # fmt: skip
    """Fill a row from one column to another. rgb, out: (w, 3). labels, inside, done: (w,)."""
    split, origin = of_lamps
    along, to_normal, merges = of_materials
    room, u = room_for(len(along)), begin
    while u < end:
        m, counts, stop = labels[u], inside[u], u + 1
        if done[u]:
            u += 1
            continue
        while stop < end and labels[stop] == m and inside[stop] == counts and not done[stop]:
            stop += 1  # as far as it is so: one matrix, or one line, for all
        if counts and along[m].any():
            take_without_pigment(
                rgb[u:stop], to_normal[m], origin, along[m], split, merges[m], room[1], out[u:stop]
            )
        else:
            _take_through(matrices[m], rgb[u:stop], out[u:stop])
        u = stop


@njit(cache=True, fastmath=True, error_model="numpy")
def _take_through(matrix: Any, rgb: Any, out: Any) -> None:
    m00, m01, m02 = matrix[0]
    m10, m11, m12 = matrix[1]
    m20, m21, m22 = matrix[2]
    for u in range(len(rgb)):
        r, g, b = rgb[u, 0], rgb[u, 1], rgb[u, 2]
        out[u, 0] = m00 * r + m01 * g + m02 * b
        out[u, 1] = m10 * r + m11 * g + m12 * b
        out[u, 2] = m20 * r + m21 * g + m22 * b
