"""The lamps' colours, found in the subject's shadows where the rig does not hold them.

A board tells M alone. With the lamps' directions, which shadows tell (`shadows/lamp_directions.py`), M is
known to be the sum of each lamp's colour times its direction, and shadows, materials and depth are found as
with a rig that was calibrated lamp by lamp.
"""

import logging
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from vntoolkit.arrays import FloatArray, Matrix3
from vntoolkit.errors import BadRig, VntError
from vntoolkit.options.reconstruction import MaterialSearch, Product, ReconstructOptions
from vntoolkit.photometry.rig import Rig
from vntoolkit.pipeline.frame_processor import FrameProcessor
from vntoolkit.pipeline.request import Footage
from vntoolkit.shadows.lamp_directions import SURE_DEG, directions_from_unlit

logger = logging.getLogger(__name__)
_LOOKED_AT = 5  # frames at once, evenly spread
_BETTER_DEG = 9.0  # deviation of a direction that helps: M's rows of a camera that mixes lamps are 4 to 9 off
_NOTHING_DEG = 30.0  # lamps stand not much farther apart
_LEAST_LIGHT = -0.05  # of the strongest channel of a lamp: light is not negative


def find_lamps(
    rig: Rig, options: ReconstructOptions, footage: Footage, numbers: Sequence[int]
) -> tuple[Rig, str]:
    """Look for the lamps in the shadows of some frames.

    Return the rig, with the lamps' colours where all three are told, and what is not told, as part of a
    warning.

    With M alone every channel counts as a lamp, so that many shadows are missed and dark paint is taken for
    some. So they are looked for again with the colours told so far, in frames between the first ones. Lamps
    that were not told count as standing where M's rows point. What the second look tells counts.
    """
    there = footage.usable(numbers)
    step = max(1, -(-len(there) // _LOOKED_AT))
    alone, guessed, unlit, in_words = rig.response, rig, _nothing(), ""
    for frames in (there[::step], there[step // 2 :: step]):
        seen = _unlit_by_lamp(guessed, options, footage, frames)
        unlit = [np.concatenate(pair) for pair in zip(unlit, seen, strict=True)]
        lamps = directions_from_unlit(unlit, alone)
        deviations_deg = np.degrees(lamps.deviations)
        in_words = lamps_in_words(tuple(deviations_deg))
        helps = deviations_deg <= _BETTER_DEG
        found = _with_colours(rig, np.where(helps[:, None], lamps.central, alone.light_directions))
        is_second_look = guessed is not rig
        if found is not None and is_second_look and deviations_deg.max() <= SURE_DEG:
            colours = found.response.light_colours
            if colours is None or (colours < _LEAST_LIGHT * colours.max(axis=1, keepdims=True)).any():
                break
            response = replace(found.response, light_doubts_deg=np.round(deviations_deg, 2))
            return replace(found, response=response), ""
        if found is not None and helps.any():
            guessed, unlit = found, _nothing()
        elif step == 1:  # the same frames would tell the same
            break
    return rig, in_words


def lamps_in_words(deviations_deg: Sequence[float]) -> str:
    """Return what shadows did not tell of the lamps, as part of a warning; empty if nobody looked."""
    if not deviations_deg:
        return ""
    if max(deviations_deg) <= SURE_DEG:
        return "with the lamps where shadows on it tell them, M would need negative light: "
    told = ", ".join(
        f"lamp {k} to {deviation:.1f} degrees" if deviation < _NOTHING_DEG else f"lamp {k} not at all"
        for k, deviation in enumerate(deviations_deg)
    )
    return f"shadows on it do not tell where the lamps stand ({told}; {SURE_DEG:.0f} are needed of each): "


def _with_colours(rig: Rig, directions: Matrix3) -> Rig | None:
    """Return the rig with the colours that M and directions (3, 3) leave to lamps; None for impossible."""
    try:
        colours = np.linalg.solve(directions.T, rig.response.matrix.T)
        return replace(rig, response=replace(rig.response, light_colours=np.round(colours, 6)))
    except (np.linalg.LinAlgError, BadRig):  # lamps in one plane, or mixtures of each other
        return None


def _nothing() -> list[FloatArray]:
    return [np.empty((0, 3)) for _ in range(3)]


def _unlit_by_lamp(
    rig: Rig, options: ReconstructOptions, footage: Footage, numbers: Sequence[int]
) -> list[FloatArray]:
    """Return for each lamp (n, 3), what it does not reach in some frames."""
    options = replace(options, to=Product.DEPTH, materials=MaterialSearch.CALIBRATED)
    capture, mattes = footage.capture, footage.mattes
    processor = FrameProcessor(rig, options, mattes.still, capture.background, with_errors=False)
    unlit = _nothing()
    for number in numbers:
        try:
            encoded = capture.encoded(number)
            seen = processor.unlit_by_lamp(encoded, mattes.of(encoded))
        except VntError as problem:  # said when its turn comes
            logger.debug("lamps not looked for: %s", problem)
            continue
        unlit = [np.concatenate(pair) for pair in zip(unlit, seen, strict=True)]
    return unlit
