"""Are presses of a tactile sensor what they are said to be? Labels, background, corners, transfer curve."""

import numpy as np
from scipy.stats import linregress

from vntoolkit.arrays import FloatArray
from vntoolkit.diagnosis.finding import CLEAR_Z, Finding
from vntoolkit.spread import robust_deviation
from vntoolkit.tactile.circles import Press

_FAR_RADII = 0.6  # of the contact: hands label to a tenth, and a fit still works with a half
_STRETCH = 0.04  # of 1: a label's scale that is off by less moves no label by more than hands do
_NARROW = 0.45  # of the ball's radius, a slope of 27 degrees; presses in real use reach 0.7 to 0.8
_FEWEST = 5  # presses that tell a scale
_LEAST_ASPECT = 16 / 15  # the mildest that video standards use; uneven light shifts a rim by less
_LEAST_LEVEL = 0.5  # of the gel's own colour: below it more than half of the picture is something else
_LEAST_STRENGTH = 0.5  # of a press: what noise and the gel's own change have in common is far less
_CLEARLY_BETTER = 0.92  # of the angle that a transfer curve leaves; noise and other lamps change it less


def check_labels(labels: FloatArray, dents: FloatArray, size: tuple[int, int]) -> list[Finding]:
    """Compare labels with the dents, both (n, 3): u, v, radius in pixels of frames of `size`."""
    if not len(labels):
        return []
    if len(labels) >= _FEWEST and np.ptp(dents[:, :2], axis=0).all():
        stretch = [linregress(dents[:, axis], labels[:, axis]) for axis in (0, 1)]
        if any(abs(fit.slope - 1) > max(_STRETCH, CLEAR_Z * fit.stderr) for fit in stretch):
            wide, high = (fit.slope for fit in stretch)
            width, height = size[0] * wide, size[1] * high
            return [Finding.of("labels/size", wide=wide, high=high, width=width, height=height)]
    offset = labels[:, :2] - dents[:, :2]
    away = np.linalg.norm(offset - np.median(offset, axis=0), axis=1) / dents[:, 2]
    far = float(np.median(np.linalg.norm(offset, axis=1) / dents[:, 2]))
    spread = float(np.median(away))
    if max(far, spread) > _FAR_RADII:
        return [Finding.of("labels/beside", radii=max(far, spread))]
    return []


def check_offset(offset_px: FloatArray, largest_px: float) -> list[Finding]:
    """Find a common offset of the labels that was stopped at its largest."""
    length = float(np.linalg.norm(offset_px))
    if length < 0.98 * largest_px:
        return []
    return [Finding.of("labels/offset", offset_px=length, largest_px=largest_px)]


def check_contacts(shares: FloatArray) -> list[Finding]:
    """Compare the contacts' radii, (n,) as shares of the ball's, with what shows steep normals.

    A diameter given as a radius halves them. Nothing else tells of it: with a larger ball M grows, and the
    fit becomes no worse.
    """
    share = float(np.median(shares))
    if share >= _NARROW:
        return []
    return [Finding.of("cone/contacts", share=share, slope_deg=np.rad2deg(np.arcsin(share)))]


def check_round(aspects: FloatArray) -> list[Finding]:
    """Compare the contacts' heights over their widths, (n,), with a circle's."""
    if len(aspects) < _FEWEST:
        return []
    logs = np.log(aspects)
    middle = float(np.median(logs))
    error = 1.25 * robust_deviation(logs - middle) / np.sqrt(len(logs))
    if abs(middle) < max(np.log(_LEAST_ASPECT), CLEAR_Z * error):
        return []
    return [Finding.of("contacts", aspect=np.exp(middle), error=error)]


def check_gel_fills_picture(level: FloatArray, at_contacts: FloatArray) -> list[Finding]:
    """Compare the picture's median colour (3,) with that of the untouched gel where presses are, (3,)."""
    share = float((level / np.maximum(at_contacts, 1e-9)).min())
    if share >= _LEAST_LEVEL:
        return []
    return [Finding.of("corners", share=share)]


def check_common_dent(
    common: Press | None, strength: float, dents: FloatArray, presses: int
) -> list[Finding]:
    """Find a dent that all presses have in common: then it is the background's.

    common: found in the median change of the presses. strength: of that change, over a press's own. dents:
    (n, 3), u, v, radius of those that were found in so many presses.
    """
    if common is None or strength < _LEAST_STRENGTH or presses < _FEWEST:
        return []
    near = np.hypot(dents[:, 0] - common.u_px, dents[:, 1] - common.v_px) < common.radius_px
    if 2 * near.sum() > presses:  # the presses themselves lie there
        return []
    measured = f"the same dent in all presses, {strength:.1f} times as strong as theirs"
    return [Finding.of("background/press", u=common.u_px, v=common.v_px, measured=measured)]


def check_press_transfer(used: str, angle_deg: float, others: dict[str, float]) -> list[Finding]:
    """Compare the angle that one M leaves under the transfer curve with the angles under others."""
    if not others:
        return []
    name, least = min(others.items(), key=lambda item: item[1])
    if least > _CLEARLY_BETTER * angle_deg:
        return []
    return [Finding.of("transfer/presses", curve=name, used=used, angle_deg=angle_deg, least_deg=least)]
