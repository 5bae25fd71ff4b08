"""How bright the subject is against the rig's material, and whether it is of that."""

import logging
from collections.abc import Callable, Sequence
from functools import partial

import numpy as np

from vntoolkit.arrays import FloatArray, Mask
from vntoolkit.errors import BadCapture, BadInput
from vntoolkit.normals.inversion import relative_albedo_from_frame
from vntoolkit.options.reconstruction import MaterialSearch, ReconstructOptions
from vntoolkit.photometry.frame import LinearFrame
from vntoolkit.photometry.response import LightResponse, scaled_normals_from_rgb
from vntoolkit.photometry.rig import Rig
from vntoolkit.pipeline.frame_processor import FrameProcessor
from vntoolkit.pipeline.request import Footage
from vntoolkit.spread import robust_deviation

logger = logging.getLogger(__name__)
_WORST_RESIDUAL = (
    0.22  # of normals' lengths; photographs of one material reach 0.16, of another colour 0.29 on
)
WRONG_LENGTH = 0.25  # of a normal, that neither noise nor shading makes
MOST_UNEXPLAINED = 0.1  # of the lit pixels: folds that light each other, eyes, buttons
JUDGED = 40_000  # pixels tell how much is not explained
LIT_SHARE = 0.06  # of the strongest lamp's light that reaches a pixel: less may be shadow
# Another colour pulls all normals towards a lamp: those of simulated garments and faces then lie 43 to 64
# degrees off, else 2 to 38. A sheet so far turned shows seven tenths of its area.
_LARGEST_TILT_DEG = 45.0
REMEDY = "film the subject while it turns, or calibrate on its own material"


def measured_brightness(
    rig: Rig, options: ReconstructOptions, footage: Footage, numbers: Sequence[int]
) -> tuple[float, Callable[[str], None]]:
    """Measure on the first frame how bright the subject is against the rig's material.

    Return that, and what logs a warning where the subject does not look like that material; it is told what
    shadows do not tell of the lamps. Raises `BadCapture` where the frame shows nothing.
    """
    first = footage.capture.encoded(footage.usable(numbers)[0])
    processor = FrameProcessor(rig, options, footage.mattes.of(first), footage.capture.background)
    frame, mask = processor.linear(first), processor.whole_mask
    try:
        albedo = relative_albedo_from_frame(frame, rig.response, mask)
    except BadInput as error:
        raise BadCapture(f"{first.name}: {error}") from error
    warn = partial(_warn_of_other_material, rig.response, options.materials, frame, mask, albedo)
    return float(np.format_float_positional(albedo, precision=4, fractional=False)), warn


def share_of_wrong_lengths(lengths: FloatArray) -> float:
    """Return the share of lengths (n,) that are far from 1, rounded as it is printed beside the limit."""
    return round(float(np.mean(np.abs(lengths - 1.0) > WRONG_LENGTH)), 2)


def _warn_of_other_material(
    response: LightResponse,
    choice: MaterialSearch | int,
    frame: LinearFrame,
    mask: Mask,
    albedo: float,
    lamps_in_words: str,
) -> None:
    lit = mask & ~frame.clipped
    step = max(1, round(float(np.sqrt(lit.sum() / JUDGED))))
    rgb, lit = frame.rgb[::step, ::step], lit[::step, ::step]
    v, u = np.nonzero(lit)
    scaled = scaled_normals_from_rgb(rgb[lit], response, float(step) * np.stack([u, v], axis=-1))
    length = np.linalg.norm(scaled, axis=1) / albedo
    bright = length > 0.3  # the rest is in shadow
    if not bright.any():
        return
    light = rgb[lit] - response.ambient
    reached = length[bright & (light > LIT_SHARE * light.max(axis=1, keepdims=True)).all(axis=1)]
    facing = (scaled[bright] / length[bright, None]).mean(axis=0)
    tilt_deg = float(np.degrees(np.arccos(np.clip(-facing[2] / np.linalg.norm(facing), -1.0, 1.0))))
    residual = round(robust_deviation(length[bright] - np.median(length[bright])), 2)
    off = share_of_wrong_lengths(reached / np.median(reached)) if reached.size else 0.0
    wrong = []
    has_colours = response.light_colours is not None  # then `measured_materials` warns of other colours
    if residual > _WORST_RESIDUAL and not (has_colours and choice is MaterialSearch.AUTO):
        wrong.append(
            f"the lengths of its normals, which should be equal, spread by {100 * residual:.0f} % (expected "
            f"below {100 * _WORST_RESIDUAL:.0f})"
        )
    elif off > MOST_UNEXPLAINED and not has_colours:
        wrong.append(
            f"the lengths of {100 * off:.0f} % of its normals are off by more than {100 * WRONG_LENGTH:.0f} "
            f"% (expected in at most {100 * MOST_UNEXPLAINED:.0f} %; gloss does this, too)"
        )
    if tilt_deg > _LARGEST_TILT_DEG:
        wrong.append(
            f"its normals point {tilt_deg:.0f} degrees away from the camera on average (expected below "
            f"{_LARGEST_TILT_DEG:.0f})"
        )
    if wrong:
        remedy = (
            f"{lamps_in_words}calibrate with one photograph per lamp (--single-light), "
            "so that --materials auto can tell them"
            if response.light_colours is None
            else "try --materials auto"
            if choice is not MaterialSearch.AUTO
            else f"--materials auto found no others that explain them; {REMEDY}"
        )
        logger.warning(
            "materials: the subject does not look like the calibration material: %s; %s",
            " and ".join(wrong), remedy,
        )  # fmt: skip
