"""Was the footage read with its own transfer curve? How the length of M⁻¹(r − a) depends on direction tells.

On one material that length is the albedo, whatever the direction. Footage read with another curve c' than it
was written with has a length that depends on the direction in a way that M and the two curves foretell. The
logarithms of the lengths are regressed on what is foretold: the slope is 0 where the curve is right and 1
where the other one is. Paint, gloss and shade scatter the lengths but do not follow the lamps' colours: they
widen the error of the slope and hardly shift it. Light from one part of a subject on another does follow
them: it lifts what is dark as an encoding curve does. So a curve is called wrong where the slope holds
although light may come from elsewhere, unevenly over the picture. Where such light and the curve cannot be
told apart, the curve must leave the lengths clearly less spread, and gains of the channels, which another hue
of the subject looks like, must not leave less. The spread of the lengths alone tells nothing: a curve that
compresses light compresses paint too.
"""

import math
from dataclasses import dataclass

import numpy as np

from vntoolkit.arrays import BoolArray, Float32Array, FloatArray, Mask
from vntoolkit.diagnosis import evidence as evidences
from vntoolkit.diagnosis.finding import CLEAR_Z, Finding, Level
from vntoolkit.diagnosis.surface_pixels import (
    SurfacePixels,
    regress_lengths,
    spread_of_lengths,
    surface_pixels,
)
from vntoolkit.diagnosis.white_balance import fit_gains
from vntoolkit.photometry.fit_quality import angles_deg
from vntoolkit.photometry.transfer import (
    Transfer,
    TransferCurve,
    encoded_from_linear,
    linear_from_encoded,
)

_LIT_DARKER = 0.1  # in the place of `LIT`, under the darker reading
_DARKEST = 0.01  # of full scale
_LEAST_CHANNEL = 0.05  # of the brightest channel foretold: below it the curve's toe and noise decide
_ROUNDS = 8  # of weighing pairs of a calibration
_LEAST_EFFECT = 0.004  # spread of the foretold logarithms: below it M and the curves say the same
# Slope as read minus slope under the other reading: −1 where the curve is right, +1 where the other one is.
# Photographs of statues and faces with the right curve reach 0.1, with the wrong one 1.7 and more.
_NOTED = 0.5
_CLEARLY_LESS = 0.65  # two free numbers always mend more than none, so a curve that mends this much may tie
# Photographs of plaster read rightly have 0.94 and more, and 0.6; the same in sRGB 0.9 and less, and 1.4.
_LESS = 0.92
# Where light may come from elsewhere, faces and statues read rightly reach 0.7, in sRGB most have 1.1 to 2.8.
_HOLDS = 1.1
# Neither curve explains a slope that the other reading turns round by as much: other materials make it, such
# as a tartan or a backdrop without a mask.
_UNEXPLAINED = 4.0
_TURNED_ROUND = 0.5


def check_transfer(evidence: evidences.Evidence) -> list[Finding]:
    """Find footage that was written with another transfer curve than it was read with."""
    other = evidences.of_the_other_kind(evidence.transfer)
    written = _comparison(evidence, other)
    if written is None or not 0.0 < written.score <= _UNEXPLAINED:
        return []
    if -written.under_other > _TURNED_ROUND * written.as_read:
        return []
    unevenly = _comparison(evidence, other, unevenly=True)
    if (
        unevenly is not None
        and unevenly.score > max(_HOLDS, CLEAR_Z * unevenly.error)
        and unevenly.as_read > CLEAR_Z * unevenly.read_error
    ):
        written = max(written, unevenly, key=lambda each: each.z)
    elif (
        written.score < max(_NOTED, CLEAR_Z * written.error)
        or (unevenly is not None and unevenly.score < -_HOLDS and -unevenly.z > written.z)
        or not _curve_is_best(evidence, other)
    ):
        return []
    return [
        Finding.of(
            "transfer",
            level=Level.FATAL if written.z > 2 * CLEAR_Z else Level.WARNING,
            curve=written.curve,
            stated=evidence.transfer.to_text(),
            slope=written.as_read,
            error=written.read_error,
        )
    ]


def check_calibrated_transfer(evidence: evidences.Evidence) -> list[Finding]:
    """Find footage that is read with another curve than the rig was calibrated with."""
    calibrated, given = evidence.rig.transfer, evidence.transfer
    if (calibrated.curve, calibrated.gamma) == (given.curve, given.gamma):
        return []
    quality = evidence.rig.quality
    if quality is not None and quality.samples == 0:  # of lamps that were measured, under no curve
        return []
    return [
        Finding.of("transfer/calibrated", given=given.to_text(), calibrated=calibrated.to_text()),
    ]


@dataclass(frozen=True, kw_only=True)
class _Comparison:
    """How two curves compare: slope of the lengths as read and its error, of those under `curve`, and the
    error of the difference.
    """

    curve: str
    as_read: float
    read_error: float
    under_other: float
    error: float

    @property
    def score(self) -> float:
        """−1 where the curve is right, +1 where the other one is."""
        return self.as_read - self.under_other

    @property
    def z(self) -> float:
        """The score in standard errors."""
        return self.score / self.error


def _comparison(
    evidence: evidences.Evidence, other: Transfer, *, unevenly: bool = False
) -> _Comparison | None:
    """Compare the reading with another; None where too little is lit or M makes no difference."""
    pixels = _lit_pixels(evidence, other)
    if len(pixels) < evidences.FEWEST_PIXELS:
        return None
    one = _slope(pixels, pixels.rgb, evidence.transfer, other, unevenly)
    reread = _reread(pixels.rgb, evidence.transfer, other)
    two = _slope(pixels, reread, other, evidence.transfer, unevenly)
    if one is None or two is None:
        return None
    return _Comparison(
        curve=other.to_text(),
        as_read=one[0],
        read_error=one[1],
        under_other=two[0],
        error=math.hypot(one[1], two[1]),
    )


def _curve_is_best(evidence: evidences.Evidence, other: Transfer) -> bool:
    """Tell where the lengths are clearly more alike under the other curve, and not more under other gains."""
    pixels = _lit_pixels(evidence, other)

    def reread(factor: float) -> FloatArray:
        return pixels.scaled_normals(_reread(pixels.rgb * factor, evidence.transfer, other))

    brighter, darker = (evidences.lengths_of(reread(factor)) for factor in (1.05, 1 / 1.05))
    growth = float(np.median(np.log(brighter / darker))) / (2 * math.log(1.05))
    as_read = spread_of_lengths(pixels.scaled, pixels.frames)
    by_curve = spread_of_lengths(reread(1.0), pixels.frames) / growth
    gains = fit_gains(evidence)
    if by_curve >= _LESS * as_read or gains is None:
        return by_curve < _LESS * as_read
    undone = pixels.rgb * np.exp(-np.array([gains.logs[0], 0.0, gains.logs[1]]))
    by_gains = spread_of_lengths(pixels.scaled_normals(undone), pixels.frames)
    return by_gains > by_curve * (_CLEARLY_LESS if by_curve < _CLEARLY_LESS * as_read else 1.0)


def _reread(light: FloatArray, read: Transfer, other: Transfer) -> FloatArray:
    """Return what light read with one curve would be, read with another."""
    return linear_from_encoded(encoded_from_linear(np.maximum(light, 0.0), read), other)


def _lit_pixels(evidence: evidences.Evidence, other: Transfer) -> SurfacePixels:
    """Return pixels that face the camera and are bright by both readings; the darker one has a lower bar."""
    darker = other.curve is not TransferCurve.LINEAR

    def lit(k: int, length: Float32Array) -> Mask:
        good = evidence.inside[k] & ~evidence.clipped[k] & (length > 0.0)
        if good.any():
            good &= length > (_LIT_DARKER if darker else evidences.LIT) * np.percentile(length[good], 95)
        return np.asarray(good)

    pixels = surface_pixels(evidence, lit)
    if not len(pixels):
        return pixels
    length = evidences.lengths_of(pixels.scaled_normals(_reread(pixels.rgb, evidence.transfer, other)))
    return pixels.of(length > (evidences.LIT if darker else _LIT_DARKER) * np.percentile(length, 95))


def _slope(
    pixels: SurfacePixels, rgb: FloatArray, read: Transfer, other: Transfer, unevenly: bool
) -> tuple[float, float] | None:
    """Return slope of log length on what `other` foretells, ± error; unevenly: beside channel and place."""
    scaled = pixels.scaled_normals(rgb)
    length = evidences.lengths_of(scaled)
    typical = float(np.median(length))
    normals = scaled / np.maximum(length, 1e-12)[:, None]
    colours = pixels.colours(normals * typical)
    lit: BoolArray = evidences.darkest_channel(colours) > np.maximum(
        _LEAST_CHANNEL * evidences.brightest_channel(colours), _DARKEST
    )
    lit &= normals[:, 2] < -evidences.STEEPEST
    if int(lit.sum()) < evidences.FEWEST_PIXELS:
        return None
    chosen, normals = pixels.of(lit), normals[lit] * typical

    def log_length(factor: float) -> FloatArray:
        reread = chosen.scaled_normals(_reread(chosen.colours(normals * factor), read, other))
        return np.log(np.maximum(evidences.lengths_of(reread), 1e-9))

    foretold = log_length(1.0)
    growth = (log_length(1.05) - log_length(1 / 1.05)) / (2 * math.log(1.05))  # of log length with log albedo
    foretold = -(foretold - np.median(foretold)) / float(np.median(growth))
    if float(foretold.std()) < _LEAST_EFFECT:
        return None
    columns = foretold[:, None]
    if unevenly:
        columns = np.column_stack([columns, normals, *chosen.of_uneven_light])
    found = regress_lengths(columns, np.log(length[lit] / typical), chosen)
    return None if found is None else (float(found.slopes[0]), max(float(found.errors[0]), 0.02))


# At calibration the normals are known: the right curve is the one under which one M explains the colours.

_SAMPLES = 20_000
_FEWEST_SAMPLES = 24  # as many poses of a board; M and ambient light are twelve numbers
_CHUNKS = 36
_LEFT = 0.7  # of the residual that the other curve must leave


def check_transfer_of_samples(normals: FloatArray, rgb: FloatArray, transfer: Transfer) -> list[Finding]:
    """Find calibration footage that was read with another curve than it was written with.

    normals, rgb: (n, 3) pairs in the order of the picture, rgb linear as read with `transfer`.
    """
    step = max(1, len(normals) // _SAMPLES)
    normals, rgb = normals[::step], rgb[::step]
    if len(normals) < _FEWEST_SAMPLES:
        return []
    other = evidences.of_the_other_kind(transfer)
    as_read = _residuals_deg(normals, rgb)
    under_other = _residuals_deg(normals, _reread(rgb, transfer, other))
    if not np.median(under_other) < _LEFT * np.median(as_read):
        return []
    chunks = min(_CHUNKS, len(normals))
    better = np.array([chunk.mean() for chunk in np.array_split(as_read - under_other, chunks)])
    z = float(better.mean() / max(better.std() / math.sqrt(chunks), 1e-6))
    if z < CLEAR_Z:
        return []
    return [
        Finding.of(
            "transfer/samples",
            curve=other.to_text(),
            stated=transfer.to_text(),
            residual_deg=np.median(as_read),
            least_deg=np.median(under_other),
        )
    ]


def _residuals_deg(normals: FloatArray, rgb: FloatArray) -> FloatArray:
    """Fit M and ambient light to pairs, outliers weighed down; return the angles (n,) it leaves, degrees."""
    design = np.column_stack([normals, np.ones(len(normals))])
    weight = np.ones(len(normals))
    for _ in range(_ROUNDS):
        root = np.sqrt(weight)[:, None]
        unknowns = np.linalg.lstsq(design * root, rgb * root, rcond=None)[0]
        left = np.linalg.norm(rgb - design @ unknowns, axis=1)
        weight = 1.0 / (1.0 + (left / (3.0 * np.median(left) + 1e-9)) ** 2)
    back = np.linalg.solve(unknowns[:3].T, (rgb - unknowns[3]).T).T
    return angles_deg(back, normals)
