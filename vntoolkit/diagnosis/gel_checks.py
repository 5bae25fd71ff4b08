"""Does footage of a tactile gel fit its rig and its background? What the untouched gel and the depth say."""

import numpy as np

from vntoolkit.arrays import FloatArray
from vntoolkit.diagnosis.evidence import CHANNELS
from vntoolkit.diagnosis.finding import Finding
from vntoolkit.geometry.maps import DepthMap
from vntoolkit.photometry.rig import Rig
from vntoolkit.tactile.contact import contact_from_depth
from vntoolkit.tactile.session import channel_order, colours_of_terms, difference_of_light

_LEAST_SHARE = 0.5  # of the dent: the rim beside a deep dent rises, too, by far less


def check_channels(colours: FloatArray, reference: FloatArray, whose: str, of: str) -> list[Finding]:
    """Find a picture with exchanged channels, by its colours over the place and those of a reference."""
    order = channel_order(colours, reference)
    if order == (0, 1, 2):
        return []
    came = ", ".join(CHANNELS[k] for k in order)
    return [Finding.of("matrix/channels", whose=whose, of=of, came=came)]


def check_background(rig: Rig, colours: FloatArray) -> list[Finding]:
    """Compare the untouched gel's colours over the place with those of the calibration."""
    if rig.gel is None or rig.gel.untouched is None:
        return []
    reference = colours_of_terms(rig.gel.untouched)
    exchanged = check_channels(colours, reference, "the background", "the gel of the calibration")
    return exchanged or check_light(rig, colours, reference, "the background", "the calibration")


def check_light(rig: Rig, colours: FloatArray, reference: FloatArray, whose: str, of: str) -> list[Finding]:
    """Find a picture in another light than a reference, by most of its colours over the place.

    M is off by as much as the light has changed, which turns the steepest normals that the calibration saw
    by that share of their tilt.
    """
    quality, off = rig.quality, difference_of_light(colours, reference)
    if quality is None or off * quality.cone_deg <= quality.residual_deg:
        return []
    off_deg = off * quality.cone_deg
    residual_deg = quality.residual_deg
    return [
        Finding.of(
            "background/light", whose=whose, of=of, off=off, off_deg=off_deg, residual_deg=residual_deg
        )
    ]


def check_raised(depth_map: DepthMap, rig: Rig) -> list[Finding]:
    """Find a gel that rises above its rest: a background that is a press. depth_map: metres, at rest 0.

    A touch pushes the gel in. What the background holds of a dent stands out of every frame.
    """
    raised = contact_from_depth(DepthMap(depth=-depth_map.depth, mask=depth_map.mask), rig.camera)
    dent = contact_from_depth(depth_map, rig.camera)
    if not raised.mask.any() or raised.depth_mm <= _LEAST_SHARE * dent.depth_mm:
        return []
    highest = int(np.argmax(np.where(raised.mask, depth_map.depth, -np.inf)))
    v, u = np.unravel_index(highest, raised.mask.shape)
    measured = f"the gel {raised.depth_mm:.2f} mm above its rest there"
    return [Finding.of("background/press", u=u, v=v, measured=measured)]
