"""Did exposure of the channels against each other change between calibration and capture?

Gains on red, green and blue that differ turn every normal: equation 1 then gives lengths that vary with the
normal and slopes that curl, as in `rig_match`. Gains that mend both were the change.
"""

from __future__ import annotations

import cv2
import numpy as np
from scipy.optimize import minimize

from vntoolkit.arrays import FloatArray, Mask
from vntoolkit.io.consistency import albedo_variation, curl_share
from vntoolkit.photometry.lambertian import scaled_normals_from_rgb
from vntoolkit.photometry.response import LightResponse

_SIDE_PX = 200  # larger pictures are averaged down: sixty evaluations then take a tenth of a second
_FLOOR = 0.05
_LARGEST_LOG_GAIN = 0.7
_NOTED_LOG_GAIN = 0.05
_MARGIN = 0.5  # gains must leave this share of the misfit: two free numbers always mend a little


def fit_gains(
    rgb: FloatArray, used: Mask, response: LightResponse, positions_px: FloatArray
) -> tuple[FloatArray, float, float]:
    """Return the capture's gains (3,) against calibration, green's 1, and the misfit with and without.

    Where the surface is so scattered that no averaged pixel is wholly of it: ones, NaN and NaN.

    rgb: (h, w, 3) linear. used: (h, w) lit and unclipped pixels of the surface. positions_px: (h, w, 2),
    where a response that varies over the image is asked.
    """
    factor = min(1.0, _SIDE_PX / max(used.shape))
    size = tuple(max(1, round(n * factor)) for n in used.shape[::-1])
    averaged = cv2.resize(np.asarray(rgb, dtype=np.float64), size, interpolation=cv2.INTER_AREA)
    small = np.asarray(averaged, dtype=np.float64)
    inside: Mask = cv2.resize(used.astype(np.float64), size, interpolation=cv2.INTER_AREA) > 0.999
    positions_px = np.asarray(cv2.resize(positions_px, size, interpolation=cv2.INTER_AREA))
    if not inside.any():
        return np.ones(3), float("nan"), float("nan")

    def misfit(logs: FloatArray) -> float:
        undone = small * np.exp([-logs[0], 0.0, -logs[1]])
        normals = scaled_normals_from_rgb(undone, response, positions_px)
        variation = albedo_variation(undone[inside], normals[inside])
        beyond = max(0.0, float(np.abs(logs).max()) - _LARGEST_LOG_GAIN)
        return (variation + _FLOOR) * curl_share(normals, inside) + beyond

    start = np.zeros(2)
    simplex = [[0, 0], [0.15, 0], [0, 0.15]]
    limits = {"maxfev": 80, "xatol": 0.003, "fatol": 1e-5, "initial_simplex": simplex}
    found = minimize(misfit, start, method="Nelder-Mead", options=limits)
    gains = np.exp([found.x[0], 0.0, found.x[1]])
    return gains, float(found.fun), misfit(start)


def text_of_gains(gains: FloatArray, left: float) -> str:
    """Return the warning for gains that leave this share of the misfit; empty where they mean nothing."""
    if not left < _MARGIN or float(np.abs(np.log(gains)).max()) < _NOTED_LOG_GAIN:
        return ""
    red, blue = (f"{100 * (gain - 1):+.0f} %" for gain in gains[[0, 2]])
    return (
        f"the white balance looks changed since calibration: red by {red} and blue by {blue} against green; "
        "lock it, and film or calibrate again; on a subject of another colour, calibrate on that colour"
    )
