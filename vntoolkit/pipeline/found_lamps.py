"""The lamps' colours, found in the subject's shadows where the rig does not hold them.

A board tells M alone. With the lamps' directions, which shadows tell (`shadows/lamp_directions.py`), M is
known to be the sum of each lamp's colour times its direction, and shadows, materials and depth are found as
with a rig that was calibrated lamp by lamp.
"""

import logging
from dataclasses import replace

import numpy as np

from vntoolkit.arrays import Matrix3, Vector3
from vntoolkit.errors import BadRig, VntError
from vntoolkit.io.footage.captures import Capture
from vntoolkit.io.footage.mattes import Mattes
from vntoolkit.pipeline.block_work import ReconstructionJob
from vntoolkit.pipeline.frame_processor import FrameProcessor
from vntoolkit.pipeline.options import MaterialSearch, Product
from vntoolkit.shadows.detector import ShadowMethod

logger = logging.getLogger(__name__)
_LOOKED_AT = 5  # frames, evenly spread
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
    directions, doubts = _directions(job, capture, mattes, numbers)
    worst_deg = float(np.degrees(doubts.max()))
    if worst_deg > _SURE_DEG:
        return job
    colours = (response.matrix @ np.linalg.inv(directions)).T
    if (colours < _LEAST_LIGHT * colours.max(axis=1, keepdims=True)).any():
        return job
    try:
        found = replace(response, light_colours=np.round(colours, 6))
    except BadRig:  # mixtures of each other
        return job
    return replace(job, rig=replace(job.rig, response=found))


def _directions(
    job: ReconstructionJob, capture: Capture, mattes: Mattes, numbers: range
) -> tuple[Matrix3, Vector3]:
    """Return (3, 3) unit vectors to the lamps, each from the frame that tells it best, and their doubts."""
    options = replace(job.options, to=Product.DEPTH, materials=MaterialSearch.CALIBRATED)
    there = [n for n in capture.present if n in numbers and not mattes.missing([n])]
    directions, doubts = np.eye(3), np.full(3, np.inf)
    for number in there[:: max(1, len(there) // _LOOKED_AT)][:_LOOKED_AT]:
        try:
            encoded = capture.encoded(number)
            matte, background = mattes.of(encoded), capture.background
            processor = FrameProcessor(job.rig, options, matte, background, with_errors=False)
            lamps = processor.normals(encoded).lamps
        except VntError as problem:  # said when its turn comes
            logger.debug("lamps not looked for: %s", problem)
            continue
        if lamps is None:
            continue
        better = lamps.doubts < doubts
        directions[better], doubts[better] = lamps.central[better], lamps.doubts[better]
    return directions, doubts
