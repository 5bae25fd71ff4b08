"""Relief that the camera has averaged away, foretold by what the same averaging takes from what is left.

A wave of slopes keeps the share a of its height in a blur of ½ px², as by weights ¼, ½, ¼. A second and a
third such blur take a (1 − a) and a² (1 − a) of what the picture has: their ratio is a, and a tells the
wave's length. A camera's blur of b px² kept a^(2b) of the wave, so that what the second blur takes, times
(a^(−2b) − 1) / (1 − a) / a, is what the camera took. Nothing of it is fitted to footage.

Noise turns normals in all directions alike, relief only along its slope: the curl of what a blur takes is
noise's alone, and tells how much of the rest is noise's too. Of a normal that leans away, the picture
foreshortens noise along the inclination, and with it the curl. The first blur's share is the noisiest and not
used.

Relief of one wavelength is foretold exactly. Of many, the short ones are lost first, and more is lost than
the ratio says: up to 4.8 times the variance where every octave holds as much. The mean of the two is taken.
"""

import math

import numpy as np

from vntoolkit.arrays import Float32Array, LinearImage, Mask
from vntoolkit.geometry.maps import NOISE_CELL_PX
from vntoolkit.photometry.response import LightResponse, scaled_normals_from_rgb

LEAST_BLUR_PX = 0.3  # what a sharper picture loses is less than its other errors
_CELL = NOISE_CELL_PX
_SQUARES_A_BLUR, _MOST_SIDE = 0.75, 4  # squares hide noise, and leave the waves that two more blurs tell
_ROWS = 8  # of squares, which three blurs make two of
_BESIDE = 3  # squares that three blurs reach
_STEEPEST_STEP = 0.02  # squared, radians²: an edge of a shadow or a fold is no relief
_DIMMEST, _BRIGHTEST = 0.5, 2.0  # over the albedo: between backdrop and gloss
# Of equal noise in all pixels, what the second and the third blur take, over its squared curl.
_OF_NOISE = np.array([1.0212, 1.3276], np.float32)
_LEAST_SHARE, _MOST_SHARE = 0.3, 0.96  # of a wave that a blur keeps: 3 pixels, and 15
_OF_MANY_WAVES = 2.2  # the geometric mean of 1 and 4.8


def side_of_squares(blur_px: float) -> int:
    """Return the side in pixels of the squares whose normals are compared."""
    return min(max(round(_SQUARES_A_BLUR * blur_px), 1), _MOST_SIDE)


def lost_over_left(found: Float32Array, blur_px: float, side: int) -> float:
    """Return the variance that blur has taken from a slope, over what `detail_left` finds left.

    found: of a whole frame, as `detail_left` returns it.
    """
    left, after = float(found[0].sum(dtype=np.float64)), float(found[2].sum(dtype=np.float64))
    if left <= 0.0:
        return 0.0
    share = math.sqrt(min(max(after / left, _LEAST_SHARE**2), _MOST_SHARE**2))
    taken = (share ** (-2.0 * (blur_px / side) ** 2) - 1.0) / (1.0 - share) / share
    return _OF_MANY_WAVES * 0.5 * taken**2  # of one of two directions


def detail_left(
    rgb: LinearImage, sound: Mask, response: LightResponse, inverse_albedo: float, side: int
) -> Float32Array:
    """Sum up what the second and the third blur take from normals, squared, without noise's part, radians².

    rgb: (h, w, 3), by one M. sound: (h, w), lit by all lights and not clipped. Returns (3, ⌈h/16⌉, ⌈w/16⌉):
    the second's sums, how many there are, the third's sums.
    """
    height, width = sound.shape
    found = np.zeros((3, -(-height // _CELL), -(-width // _CELL)), np.float32)
    row = np.arange(0, found.shape[1], 2)  # neighbours tell the other cells
    tops = row * _CELL + (_CELL - _ROWS * side) // 2
    row, tops = (each[(tops >= 0) & (tops + _ROWS * side <= height)] for each in (row, tops))
    squares = width // side
    if not len(tops) or squares < 2 * _BESIDE + 2:
        return found
    strips = tops[:, None] + np.arange(_ROWS * side)
    normals, good = _squares(rgb[strips], sound[strips], response, inverse_albedo, side)
    near = np.lib.stride_tricks.sliding_window_view(good, 2 * _BESIDE + 2, axis=1).all(axis=-1)
    blurred = [_blurred(normals)]  # what one, two, three blurs make of it
    for _ in range(2):
        blurred.append(_blurred(blurred[-1]))
    middle = blurred[2].shape[1:3]
    once, twice, thrice = (_inner(each, middle) for each in blurred)
    facing = once[:, 0, :-1, 2] ** 2 / (np.square(once[:, 0, :-1]).sum(axis=-1) + np.float32(1e-9))
    of_tilt = (1 + facing) / (1 + facing**2)
    parts = [
        _taken(*pair, of_tilt * of_noise)
        for pair, of_noise in zip(((once, twice), (twice, thrice)), _OF_NOISE, strict=True)
    ]
    near &= np.all([total < 4 * _STEEPEST_STEP for _, total in parts], axis=0)
    column = np.minimum((np.arange(near.shape[1]) + _BESIDE + 1) * side // _CELL, found.shape[2] - 1)
    for k, values in enumerate((parts[0][0], np.ones_like(of_tilt), parts[1][0])):
        np.add.at(found[k], (row[:, None], column), near * values)
    return found


def _squares(
    rgb: LinearImage, sound: Mask, response: LightResponse, inverse_albedo: float, side: int
) -> tuple[Float32Array, Mask]:
    """Scaled normals (s, 8, n, 3) of squares of strips (s, 8 side, w), and (s, n) whether all are sound."""
    count, squares = len(rgb), rgb.shape[2] // side
    shape = (count, _ROWS, side, squares, side)
    mean = rgb[:, :, : squares * side].reshape(*shape, 3).mean(axis=(2, 4))
    whole = sound[:, :, : squares * side].reshape(shape).all(axis=(1, 2, 4))
    normals = scaled_normals_from_rgb(mean, response) * np.float32(inverse_albedo)
    square = np.square(normals).sum(axis=-1)
    kept = (square > _DIMMEST**2) & (square < _BRIGHTEST**2) & (normals[..., 2] < 0)
    return normals, whole & kept.all(axis=1)


def _blurred(normals: Float32Array) -> Float32Array:
    """¼, ½, ¼ of three neighbours, along rows and columns; those at the ends, (s, m, n, 3), are left out."""
    rows = (normals[:, :-2] + normals[:, 2:]) / 4 + normals[:, 1:-1] / 2
    return np.asarray((rows[:, :, :-2] + rows[:, :, 2:]) / 4 + rows[:, :, 1:-1] / 2, np.float32)


def _inner(normals: Float32Array, shape: tuple[int, int]) -> Float32Array:
    top, left = ((a - b) // 2 for a, b in zip(normals.shape[1:3], shape, strict=True))
    return normals[:, top : top + shape[0], left : left + shape[1]]


def _taken(
    before: Float32Array, after: Float32Array, of_noise: Float32Array
) -> tuple[Float32Array, Float32Array]:
    """(s, n) of four neighbours each: the square of what a blur takes across normals, without and with noise.

    of_noise: (s, n), over its squared curl.
    """
    step = after - before
    along = (step * before).sum(axis=-1) / (np.square(before).sum(axis=-1) + np.float32(1e-9))
    step = step - along[..., None] * before
    total = np.square(step).sum(axis=-1)
    total = (total[:, :, :-1] + total[:, :, 1:]).sum(axis=1)
    down = np.diff(step[..., 0], axis=1)[:, 0]
    right = np.diff(step[..., 1], axis=2).sum(axis=1)
    curl = down[:, :-1] + down[:, 1:] - right
    return (total - of_noise * curl**2) / 4, total
