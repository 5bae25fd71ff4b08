"""The lamps' colours, found in the subject's shadows where the rig does not hold them.

A board tells M alone. With the lamps' directions, which shadows tell (`shadows/lamp_directions.py`), M is
known to be the sum of each lamp's colour times its direction, and shadows, materials and depth are found as
with a rig that was calibrated lamp by lamp.
"""

import logging
from dataclasses import replace

import numpy as np

from vntoolkit.arrays import FloatArray
from vntoolkit.errors import BadRig, VntError
from vntoolkit.io.footage.captures import Capture
from vntoolkit.io.footage.mattes import Mattes
from vntoolkit.pipeline.block_work import ReconstructionJob
from vntoolkit.pipeline.frame_processor import FrameProcessor
from vntoolkit.pipeline.options import MaterialSearch, Product
from vntoolkit.shadows.detector import ShadowMethod
from vntoolkit.shadows.lamp_directions import LampDirections, directions_from_unlit

logger = logging.getLogger(__name__)
_LOOKED_AT = 5  # frames, evenly spread, and where these do not tell all lamps, others between them …
_AT_MOST = 10  # … within a second and a half at 640×480
_SURE_DEG = 4.0  # standard deviation of a direction: M's rows of a camera that mixes lamps are off by 4 to 9
_LEAST_LIGHT = -0.05  # of the strongest channel of a lamp: light is not negative


def with_found_lamps(
    job: ReconstructionJob, capture: Capture, mattes: Mattes, numbers: range
) -> ReconstructionJob:
    """Return the job with the lamps' colours in its rig, as far as shadows on some frames tell all three."""
    response = job.rig.response
    if response.light_colours is not None or job.rig.gel is not None:
        return job
    if job.options.shadows is not ShadowMethod.ROBUST or job.options.materials is MaterialSearch.CALIBRATED:
        return job
    lamps = _lamps(job, capture, mattes, numbers)
    if lamps.doubts.max() > np.radians(_SURE_DEG):
        return job
    colours = (response.matrix @ np.linalg.inv(lamps.central)).T
    if (colours < _LEAST_LIGHT * colours.max(axis=1, keepdims=True)).any():
        return job
    doubts_deg = np.round(np.degrees(lamps.doubts), 3)
    try:
        found = replace(response, light_colours=np.round(colours, 6), light_doubts_deg=doubts_deg)
    except BadRig:  # mixtures of each other
        return job
    return replace(job, rig=replace(job.rig, response=found))


def _lamps(job: ReconstructionJob, capture: Capture, mattes: Mattes, numbers: range) -> LampDirections:
    """Return what the shadows of some frames together tell of the lamps."""
    options = replace(job.options, to=Product.DEPTH, materials=MaterialSearch.CALIBRATED)
    there = [n for n in capture.present if n in numbers and not mattes.missing([n])]
    processor = FrameProcessor(job.rig, options, mattes.still, capture.background, with_errors=False)
    unlit: list[FloatArray] = [np.empty((0, 3))] * 3
    lamps = directions_from_unlit(unlit, job.rig.response)
    step = -(-len(there) // _AT_MOST)
    chosen = there[::step][::2] + there[::step][1::2]
    for looked_at, number in enumerate(chosen):
        if looked_at >= _LOOKED_AT and lamps.doubts.max() <= np.radians(_SURE_DEG):
            break
        try:
            encoded = capture.encoded(number)
            seen = processor.unlit_by_lamp(encoded, mattes.of(encoded))
        except VntError as problem:  # said when its turn comes
            logger.debug("lamps not looked for: %s", problem)
            continue
        unlit = [np.concatenate(pair) for pair in zip(unlit, seen, strict=True)]
        lamps = directions_from_unlit(unlit, job.rig.response)
    return lamps
