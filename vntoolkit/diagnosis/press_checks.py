"""Are presses of a tactile sensor what they are said to be? Labels, background, corners, transfer curve."""

import numpy as np

from vntoolkit.arrays import FloatArray
from vntoolkit.diagnosis.finding import Finding, Level
from vntoolkit.tactile.circles import FoundCircle

_FAR_RADII = 0.6  # of the contact: hands label to a tenth, and a fit still works with a half
_STRETCH = 0.04  # of 1: a label's scale that is off by less moves no label by more than hands do
_SURE = 4.0  # standard errors
_NARROW = 0.45  # of the ball's radius, a slope of 27 degrees; presses in real use reach 0.7 to 0.8
_FEWEST = 5  # presses that tell a scale
_LEAST_ASPECT = 16 / 15  # the mildest that video standards use; uneven light shifts a rim by less
_LEAST_LEVEL = 0.5  # of the gel's own colour: below it more than half of the picture is something else
_LEAST_STRENGTH = 0.5  # of a press: what noise and the gel's own change have in common is far less
_CLEARLY_BETTER = 0.92  # of the angle that a transfer curve leaves; noise and other lamps change it less


def check_labels(labels: FloatArray, found: FloatArray, size: tuple[int, int]) -> list[Finding]:
    """Compare labels with the dents found, both (n, 3): u, v, radius in pixels of frames of `size`."""
    if not len(labels):
        return []
    if len(labels) >= _FEWEST:
        stretch = [_slope(found[:, axis], labels[:, axis]) for axis in (0, 1)]
        if any(abs(slope - 1) > max(_STRETCH, _SURE * error) for slope, error in stretch):
            asked = (round(size[0] * stretch[0][0]), round(size[1] * stretch[1][0]))
            return [
                Finding(
                    check="labels",
                    level=Level.FATAL,
                    problem="the labels are of a picture of another size than the presses",
                    measured=f"{stretch[0][0]:.2f} times the dents' distances in u, {stretch[1][0]:.2f} in v",
                    expected="1.00",
                    remedy=f"name the labels' picture with --label-size, about {asked[0]} {asked[1]}",
                )
            ]
    offset = labels[:, :2] - found[:, :2]
    away = np.linalg.norm(offset - np.median(offset, axis=0), axis=1) / found[:, 2]
    far = float(np.median(np.linalg.norm(offset, axis=1) / found[:, 2]))
    spread = float(np.median(away))
    if max(far, spread) > _FAR_RADII:
        return [
            Finding(
                check="labels",
                level=Level.FATAL,
                problem="the labels lie beside the dents",
                measured=f"{max(far, spread):.1f} contact radii, median",
                expected=f"less than {_FAR_RADII:g}",
                remedy=(
                    "are these the labels of these images, and of this rectification? Without --labels the "
                    "contact circles are found"
                ),
            )
        ]
    return []


def check_offset(offset_px: FloatArray, largest_px: float) -> list[Finding]:
    """Find a common offset of the labels that was stopped at its largest."""
    length = float(np.linalg.norm(offset_px))
    if length < 0.98 * largest_px:
        return []
    return [
        Finding(
            check="labels",
            level=Level.FATAL,
            problem="the labels lie beside the dents by as much as is allowed for, or more",
            measured=f"an offset of {length:.1f} pixels",
            expected=f"less than {largest_px:.1f}",
            remedy="label again, or leave --labels out: the contact circles are then found",
        )
    ]


def check_contacts(shares: FloatArray) -> list[Finding]:
    """Compare the contacts' radii, (n,) as shares of the ball's, with what shows steep normals.

    A diameter given as a radius halves them. Nothing else tells of it: with a larger ball M grows, and the
    fit becomes no worse.
    """
    share = float(np.median(shares))
    if share >= _NARROW:
        return []
    return [
        Finding(
            check="cone",
            level=Level.WARNING,
            problem="the contacts are narrow for this ball, so they show no steep slopes",
            measured=f"contact radius {share:.2f} of the ball's, {np.rad2deg(np.arcsin(share)):.0f} degrees",
            expected=f"{_NARROW:g} or more",
            remedy="press deeper; or was the ball's diameter given as --ball-radius-mm?",
        )
    ]


def check_round(aspects: FloatArray) -> list[Finding]:
    """Compare the contacts' heights over their widths, (n,), with a circle's."""
    if len(aspects) < _FEWEST:
        return []
    logs = np.log(aspects)
    middle = float(np.median(logs))
    error = 1.25 * 1.48 * float(np.median(np.abs(logs - middle))) / np.sqrt(len(logs))
    if abs(middle) < max(np.log(_LEAST_ASPECT), _SURE * error):
        return []
    return [
        Finding(
            check="contacts",
            level=Level.WARNING,
            problem="the contacts are no circles: a pixel is not as high as wide, so that areas and depths "
            "are off",
            measured=f"contacts {np.exp(middle):.3f} ± {error:.3f} times as high as wide, median",
            expected="1",
            remedy="scale the frames to square pixels, or give --corners and --size-mm, which take a size "
            "each way",
        )
    ]


def check_gel_fills_picture(level: FloatArray, at_contacts: FloatArray) -> list[Finding]:
    """Compare the picture's median colour (3,) with that of the untouched gel where presses are, (3,)."""
    share = float((level / np.maximum(at_contacts, 1e-9)).min())
    if share >= _LEAST_LEVEL:
        return []
    return [
        Finding(
            check="corners",
            level=Level.FATAL,
            problem="most of the picture is darker than the gel where it is pressed: a dark frame around it",
            measured=f"a median of {share:.2f} times the gel's colour",
            expected=f"{_LEAST_LEVEL:g} or more",
            remedy="give --corners and --size-mm, the gel's corners in the picture and the size between them",
        )
    ]


def check_common_dent(
    common: FoundCircle | None, strength: float, found: FloatArray, presses: int
) -> list[Finding]:
    """Find a dent that all presses have in common: then it is the background's.

    common: found in the median change of the presses. strength: of that change, over a press's own. found:
    (n, 3), u, v, radius of the dents that were found in so many presses.
    """
    if common is None or strength < _LEAST_STRENGTH or presses < _FEWEST:
        return []
    at = common.press
    near = np.hypot(found[:, 0] - at.u_px, found[:, 1] - at.v_px) < at.radius_px
    if 2 * near.sum() > presses:  # the presses themselves lie there
        return []
    return [
        Finding(
            check="background",
            level=Level.FATAL,
            problem=f"the background holds a dent, at u {at.u_px:.0f} v {at.v_px:.0f}: it is a press itself",
            measured=f"the same dent in all presses, {strength:.1f} times as strong as theirs",
            expected="no dent in common",
            remedy="take the background while nothing touches the gel",
        )
    ]


def check_press_transfer(used: str, angle_deg: float, others: dict[str, float]) -> list[Finding]:
    """Compare the angle that one M leaves under the transfer curve with the angles under others."""
    if not others:
        return []
    name, least = min(others.items(), key=lambda item: item[1])
    if least > _CLEARLY_BETTER * angle_deg:
        return []
    return [
        Finding(
            check="transfer",
            level=Level.WARNING,
            problem=f"the presses fit better with the transfer curve {name} than with {used}",
            measured=f"{angle_deg:.1f} degrees left by one M",
            expected=f"{least:.1f}, as with {name}",
            remedy=f"calibrate with --transfer {name}; tactile sensors mostly store raw values",
        )
    ]


def _slope(x: FloatArray, y: FloatArray) -> tuple[float, float]:
    """Slope of y over x and its standard error; 1 and infinity where x does not vary."""
    deviation = x - x.mean()
    spread = float((deviation**2).sum())
    if not spread > 0:
        return 1.0, np.inf
    slope = float((deviation * (y - y.mean())).sum() / spread)
    rest = y - y.mean() - slope * deviation
    return slope, float(np.sqrt((rest**2).sum() / max(len(x) - 2, 1) / spread))
