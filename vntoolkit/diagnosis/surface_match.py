"""Do the normals that a rig gives make a surface? If not, which mistake about M would explain the footage?

The slopes (p, q) of a surface are a gradient, so that their mixed derivatives agree, ∂p/∂v = ∂q/∂u. As one
complex number per pixel, α = (∂p/∂u + ∂q/∂v) + i (∂p/∂v − ∂q/∂u) is real on every surface. Lamps that stand
turned by θ about the optical axis multiply α by exp(iθ); mirrored lamps put β = (∂q/∂v − ∂p/∂u) −
i (∂p/∂v + ∂q/∂u) in its place. The mean of α² over the subject, over that of |α|², is the agreement: 1 for a
surface, 0 for noise, −1 for lamps turned by 90 degrees. Convex and concave agree alike: see `outline`.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import lru_cache

import cv2
import numpy as np

from vntoolkit.arrays import BoolArray, Float32Array, FloatArray, Matrix3
from vntoolkit.diagnosis.evidence import (
    CHANNELS,
    FEWEST_PIXELS,
    STEEPEST,
    Evidence,
    jackknife_error,
    lengths_of,
    scaled_normals,
)
from vntoolkit.diagnosis.finding import Finding, Level
from vntoolkit.diagnosis.outline import outline

_BLUR_PX = 1.5  # of averaged pixels: calms noise before differences are taken
_LEAST_LIGHT = 1e-3
# A relative of M is named where it agrees better by this many standard errors, and where the product of
# disagreement and spread of lengths falls by this factor. Sound photographs of faces and statues stay below.
_Z = 3.0
_LOG_FACTOR = 0.4
_LEAST_AGREEMENT = 0.25  # of a reading that is worth more than chance
_CERTAIN = 0.75  # an agreement above it that no mirror image comes near needs no mistakes tried
_SOUND = 0.9  # agreement of a surface that nothing dilutes, at least
_FATAL_GAIN = 0.2  # of agreement
_NOTED_TURN_DEG = 12.0  # photographs with lamps measured on a chrome ball show up to 7
# A step of log colour over four averaged pixels that is of paint, not shape; slopes beside it tell nothing.
_PAINT_STEP, _PAINT_REACH_PX, _BESIDE_PX = 0.5, 2, 1
_SEVERAL_COLOURS = 0.1  # of the subject beside such steps
_LAG_PX = 4
_LEAST_COHERENCE = 0.25
_FLATTEST_DEG = 2.5


def check_structure(evidence: Evidence) -> list[Finding]:
    """Find footage that shows no surface: noise, or a plane that fills the mask.

    Normals four averaged pixels apart are compared: their covariance is the surface's own, without noise.
    """
    seen = structure(evidence)
    if seen.pixels < FEWEST_PIXELS or not seen.faces_camera:
        return []
    if seen.is_noise:
        return [Finding.of("noise", coherence=seen.coherence)]
    if seen.is_flat:
        return [Finding.of("flat", spread_deg=seen.own_deg)]
    return []


@dataclass(frozen=True, kw_only=True)
class Structure:
    """How the rig's normals vary over the subject.

    coherence: correlation of normals four pixels apart. spread_deg: of all normals about their mean. pixels:
    how many. faces_camera: whether most normals do.
    """

    coherence: float
    spread_deg: float
    pixels: int
    faces_camera: bool

    @property
    def own_deg(self) -> float:
        """The spread without noise."""
        return self.spread_deg * math.sqrt(max(0.0, self.coherence))

    @property
    def is_noise(self) -> bool:
        """True where neighbours' normals have nothing to do with each other."""
        noise_deg = self.spread_deg * math.sqrt(max(0.0, 1.0 - self.coherence))
        return self.coherence < _LEAST_COHERENCE and noise_deg > 2 * _FLATTEST_DEG

    @property
    def is_flat(self) -> bool:
        """True where a surface shows no shape beyond its noise."""
        return self.own_deg < _FLATTEST_DEG


@lru_cache(maxsize=2)  # two checks ask
def structure(evidence: Evidence) -> Structure:
    """Return how the rig's normals vary over the subject."""
    products = total = 0.0
    pairs = count = facing = 0
    for light, used in zip(evidence.light, evidence.surface, strict=True):
        scaled = scaled_normals(evidence, light)
        length = lengths_of(scaled)
        inside = used & (length > 0)
        if not inside.any():
            continue
        normals = scaled / np.maximum(length, 1e-12)[..., None]
        facing += int((normals[..., 2][inside] < 0).sum())
        normals = normals - normals[inside].mean(axis=0)
        total += float((normals[inside] ** 2).sum())
        count += int(inside.sum())
        for axis in (0, 1):
            along, there = np.moveaxis(normals, axis, 0), np.moveaxis(inside, axis, 0)
            both = there[:-_LAG_PX] & there[_LAG_PX:]
            products += float((along[:-_LAG_PX] * along[_LAG_PX:]).sum(axis=2)[both].sum())
            pairs += int(both.sum())
    if not count or not pairs or not total:
        return Structure(coherence=1.0, spread_deg=90.0, pixels=0, faces_camera=True)
    variance = total / count
    return Structure(
        coherence=products / pairs / variance,
        spread_deg=math.degrees(math.sqrt(variance)),
        pixels=count,
        faces_camera=facing > 0.5 * count,
    )


def check_mistakes(evidence: Evidence) -> list[Finding]:
    """Find the mistake about M that explains the footage clearly better than M does."""
    seen = structure(evidence)
    if seen.pixels < FEWEST_PIXELS or (seen.faces_camera and (seen.is_noise or seen.is_flat)):
        return []
    own = _own_sums(evidence)
    as_calibrated = _Reading.of("as calibrated", "", own)
    if as_calibrated.leaves_no_doubt(own):
        return []
    better = []
    if own.pixels >= FEWEST_PIXELS or own.front_share < 0.5:
        better = _better(evidence, as_calibrated, _mistakes_of(evidence))
    if better:
        return [_finding(as_calibrated, better)]
    if own.front_share >= 0.5:
        return _undecided(evidence, as_calibrated, _Reading.of("", "", own, mirrored=True))
    return [Finding.of("matrix/away", share=1 - own.front_share)]


def paint_may_hide_surface(evidence: Evidence) -> bool:
    """Tell where footage makes hardly a surface under this M."""
    seen = structure(evidence)
    if seen.pixels < FEWEST_PIXELS or seen.is_noise or seen.is_flat:
        return False
    own = _Reading.of("", "", _own_sums(evidence))
    return own.front_share >= 0.5 and own.agreement <= _LEAST_AGREEMENT


def note_of_levelled_paint(levelled: Evidence, plain: Evidence) -> Finding | None:
    """Return a note where footage makes more of a surface in one paint than as it is, under its best M."""
    before, after = _most_of_a_surface(plain), _most_of_a_surface(levelled)
    if after <= before:
        after = _most_of_a_surface(_read_otherwise(levelled))
    if after <= before:
        return None
    apart = levelled.rig.response.light_colours is not None  # then `reconstruct` tells the paints
    name = "matrix/paint-told-apart" if apart else "matrix/paint"
    return Finding.of(name, before=before, after=after)


def _most_of_a_surface(evidence: Evidence) -> float:
    own = _own_sums(evidence)
    if own.pixels < FEWEST_PIXELS:
        return 0.0
    return max(reading.agreement for reading in (_Reading.of("", "", own), *_mistakes_of(evidence)))


def _undecided(evidence: Evidence, own: _Reading, mirrored: _Reading) -> list[Finding]:
    """Tell where M agrees hardly with the footage, and its mirror image alike: nothing was checked then."""
    tells = own.agreement > _LEAST_AGREEMENT and evidence.painted is None
    if tells or abs(own.z_above(mirrored)) > _Z:
        return []
    painted = float(_seams_of_paint(evidence)[evidence.surface].mean())
    name = "matrix/unchecked-paint" if painted > _SEVERAL_COLOURS else "matrix/unchecked"
    return [
        Finding.of(
            name,
            painted=painted,
            own=own.agreement,
            error=own.standard_error,
            mirrored=mirrored.agreement,
        )
    ]


def agreement_of(evidence: Evidence, mix: Matrix3) -> float:
    """Return the agreement of the mixed derivatives, −1 to 1, where colours r are read as K r; mix: K."""
    return _Reading.of("", "", _Sums.of(evidence, mix)).agreement


@dataclass(frozen=True, kw_only=True, eq=False)
class _Sums:
    """Sums over blocks (b, 10): α² (2), |α|², β² (2), |β|², facing, all, log length, pixels with an α."""

    blocks: FloatArray

    @classmethod
    def of(
        cls,
        evidence: Evidence,
        mix: Matrix3 | None = None,
        inverse: Float32Array | None = None,
    ) -> _Sums:
        total = np.zeros((int(evidence.blocks.max()) + 1, 10))
        seams = _seams_of_paint(evidence)
        for light, used, seam in zip(evidence.light, evidence.surface, seams, strict=True):
            if used.any():
                total += _block_sums(evidence, scaled_normals(evidence, light, mix, inverse), used, seam)
        return cls(blocks=total[total[:, 7] > 0])

    @property
    def total(self) -> FloatArray:
        """(1, 10)."""
        return self.blocks.sum(axis=0, keepdims=True)

    @property
    def left_out(self) -> FloatArray:
        """(b, 10), each without one block."""
        return self.total - self.blocks

    @property
    def pixels(self) -> int:
        """How many tell whether mixed derivatives agree."""
        return int(self.blocks[:, 9].sum())

    @property
    def front_share(self) -> float:
        total = self.total[0]
        return float(total[6] / total[7]) if total[7] else 1.0


@lru_cache(maxsize=2)  # every relative of M asks
def _seams_of_paint(evidence: Evidence) -> BoolArray:
    """(k, h, w): beside a step of colour, whatever M is. What is printed on a surface is no slope."""
    seams = np.zeros(evidence.surface.shape, np.bool_)
    for light, used, seam in zip(evidence.light, evidence.surface, seams, strict=True):
        logs = np.log(np.maximum(cv2.GaussianBlur(light, (0, 0), _BLUR_PX), _LEAST_LIGHT))
        for axis in (0, 1):
            along, there, beside = (np.moveaxis(each, axis, 0) for each in (logs, used, seam))
            steps = np.abs(along[2 * _PAINT_REACH_PX :] - along[: -2 * _PAINT_REACH_PX]).max(axis=-1)
            both = there[2 * _PAINT_REACH_PX :] & there[: -2 * _PAINT_REACH_PX]
            beside[_PAINT_REACH_PX:-_PAINT_REACH_PX] |= (steps > _PAINT_STEP) & both
        grown = np.ones((2 * _BESIDE_PX + 1, 2 * _BESIDE_PX + 1), np.uint8)
        seam[:] = cv2.dilate(seam.astype(np.uint8), grown) > 0
    return seams


def _block_sums(evidence: Evidence, scaled: Float32Array, used: BoolArray, seams: BoolArray) -> FloatArray:
    whole = used.astype(np.float32)
    smooth = cv2.GaussianBlur(scaled * whole[..., None], (0, 0), _BLUR_PX)
    covered = cv2.GaussianBlur(whole, (0, 0), _BLUR_PX) > 0.98
    length = lengths_of(smooth)
    normals = smooth / np.maximum(length, 1e-12)[..., None]
    facing = np.einsum("vui,vui->vu", normals, evidence.directions)
    front = covered & (facing < -STEEPEST)
    depth = np.minimum(facing, -STEEPEST)
    p_u, p_v = _gradient(normals[..., 0] / depth)
    q_u, q_v = _gradient(normals[..., 1] / depth)
    valid = cv2.erode(front.astype(np.uint8), np.ones((3, 3), np.uint8), borderValue=0) > 0
    valid &= ~seams
    div, curl = p_u + q_v, p_v - q_u  # α
    shear, twist = q_v - p_u, -(p_v + q_u)  # β
    # the root of the energy, not the energy: creases and edges of paint shall not outvote the rest
    weight = facing**2 / np.sqrt(div**2 + curl**2 + shear**2 + twist**2 + 1e-12)
    logs = np.log(np.maximum(length, 1e-9))
    centre = np.median(logs[front]) if front.any() else np.float32(0)
    count = int(evidence.blocks.max()) + 1
    sums = np.zeros((count, 10))
    blocks = evidence.blocks[valid]
    weight, div, curl, shear, twist = (x[valid] for x in (weight, div, curl, shear, twist))
    columns = (
        weight * (div**2 - curl**2),
        weight * 2 * div * curl,
        weight * (div**2 + curl**2),
        weight * (shear**2 - twist**2),
        weight * 2 * shear * twist,
        weight * (shear**2 + twist**2),
    )
    for k, column in enumerate(columns):
        sums[:, k] = np.bincount(blocks, column, count)
    sums[:, 6] = np.bincount(evidence.blocks[front], minlength=count)
    sums[:, 7] = np.bincount(evidence.blocks[covered], minlength=count)
    departure = np.minimum(np.abs(logs[front] - centre), 1.0)
    sums[:, 8] = np.bincount(evidence.blocks[front], departure, count)
    sums[:, 9] = np.bincount(blocks, minlength=count)
    return sums


def _gradient(values: Float32Array) -> tuple[Float32Array, Float32Array]:
    along_u, along_v = np.zeros_like(values), np.zeros_like(values)
    along_u[:, 1:-1] = (values[:, 2:] - values[:, :-2]) / 2
    along_v[1:-1] = (values[2:] - values[:-2]) / 2
    return along_u, along_v


@dataclass(frozen=True, kw_only=True, eq=False)
class _Reading:
    """The footage under one idea of M.

    agreements: (1 + b,), on the whole, and without each block. besides: logarithm of what else does not fit.
    sound: the agreement that a surface has in this light.
    """

    name: str
    remedy: str
    agreements: FloatArray
    besides: float
    front_share: float
    sound: float = 1.0

    @classmethod
    def of(
        cls, name: str, remedy: str, sums: _Sums, *, mirrored: bool = False, turned: bool = False
    ) -> _Reading:
        """mirrored: as if the lamps were mirrored. turned: as if they stood turned as fits best."""
        rows = np.concatenate([sums.total, sums.left_out])
        squares, powers = (rows[:, 3], rows[:, 5]) if mirrored else (rows[:, 0], rows[:, 2])
        if turned:
            squares = np.hypot(rows[:, 0], rows[:, 1])
        agreements = squares / np.maximum(powers, 1e-12)
        spread = float(rows[0, 8] / max(rows[0, 6], 1.0))
        facing = float(rows[0, 6] / max(rows[0, 7], 1.0))
        return cls(
            name=name,
            remedy=remedy,
            agreements=agreements,
            besides=math.log((spread + 0.03) / (facing + 0.01)),
            front_share=facing,
        )

    def leaves_no_doubt(self, sums: _Sums) -> bool:
        """True where no relative of M could agree better: all are near a mirror image or a turn."""
        turn_deg, _ = _turn_deg(sums)
        mirrored = _Reading.of("", "", sums, mirrored=True).agreement
        return (
            self.agreement > _CERTAIN
            and abs(turn_deg) < _NOTED_TURN_DEG
            and mirrored < self.agreement - _FATAL_GAIN
            and self.front_share > 0.7
        )

    @property
    def agreement(self) -> float:
        return float(self.agreements[0])

    @property
    def misfit(self) -> float:
        return math.log(max(1.05 - self.agreement / self.sound, 0.05)) + self.besides

    @property
    def standard_error(self) -> float:
        return float(jackknife_error(self.agreements[1:]))

    def z_above(self, other: _Reading) -> float:
        """By how many standard errors this agreement lies above another's."""
        gain = self.agreement - other.agreement
        if len(self.agreements) != len(other.agreements):  # other pixels, as where nothing faced the camera
            return gain / max(1e-3, math.hypot(self.standard_error, other.standard_error))
        return gain / max(1e-3, float(jackknife_error(self.agreements[1:] - other.agreements[1:])))

    def explains_better(self, other: _Reading) -> bool:
        if self.front_share < 0.7 or self.agreement < _LEAST_AGREEMENT:
            return False
        if other.front_share < 0.5:
            return True
        return self.misfit < other.misfit - _LOG_FACTOR and self.z_above(other) > _Z


@lru_cache(maxsize=4)  # as it is, levelled, and both read otherwise
def _own_sums(evidence: Evidence) -> _Sums:
    return _Sums.of(evidence)


@lru_cache(maxsize=4)
def _mistakes_of(evidence: Evidence) -> tuple[_Reading, ...]:
    return tuple(_mistakes(evidence, _own_sums(evidence)))


def _mistakes(evidence: Evidence, own: _Sums) -> Iterator[_Reading]:
    """Yield what the footage looks like under every single mistake about M."""
    seen = outline(evidence)

    def likelier(*changes: FloatArray) -> list[int]:
        """Of changes of (x, y) that agree alike, those under which the outline turns outwards."""
        if seen is None:
            return list(range(len(changes)))
        outward = [seen.outward(change) for change in changes]
        return [k for k, (mean, error) in enumerate(outward) if mean > -_Z * error] or [0]

    axes = likelier(np.diag([-1.0, 1.0]), np.diag([1.0, -1.0]))
    yield _Reading.of(
        f"with its {' or its '.join(('x', 'y')[k] for k in axes)} axis mirrored",
        "give the lamps with x right, y down, z forward in rig.json (lamp files: x right, y up, z to "
        "the viewer), or calibrate again",
        own,
        mirrored=True,
    )
    turn, error = _turn_deg(own)
    if abs(turn) > max(_NOTED_TURN_DEG, _Z * error):
        turns = [turn, turn - math.copysign(180, turn)]
        likely = " or ".join(f"{turns[k]:+.0f}" for k in likelier(*map(_rotation, turns)))
        yield _Reading.of(
            f"with the lamps turned about the camera's axis by {likely} ± {error:.0f} degrees, clockwise in "
            "the picture",
            "were lamps or camera turned since calibration? calibrate again",
            own,
            turned=True,
        )
    saved = "was the footage saved in another channel order, such as BGR? save it as RGB"
    for order in _orders():
        sums = _Sums.of(evidence, np.eye(3)[list(order)])
        yield _Reading.of(f"with {_exchanged(order, CHANNELS)}", saved, sums)
    transposed = evidence.inverse_of(evidence.rig.response.matrix.T)
    by_axis = "write M with a row per channel and a column per axis"
    yield _Reading.of("with M transposed", by_axis, _Sums.of(evidence, inverse=transposed))
    colours = evidence.rig.response.light_colours
    if colours is not None:
        lamps = ("the first lamp", "the second lamp", "the third lamp")
        in_one_order = "list the lamps' directions and colours in one order"
        for order in _orders():
            mix = colours.T @ np.eye(3)[list(order)] @ np.linalg.inv(colours.T)
            yield _Reading.of(f"with {_exchanged(order, lamps)}", in_one_order, _Sums.of(evidence, mix))


def _read_otherwise(evidence: Evidence) -> Evidence:
    """Return the footage read with another curve; where it is levelled, paint is told anew."""
    if evidence.painted is None:
        return evidence.read_otherwise
    return evidence.painted.read_otherwise.levelled


def _better(evidence: Evidence, own: _Reading, mistakes: tuple[_Reading, ...]) -> list[_Reading]:
    """Return the readings that explain the footage better than M does, best first.

    Another curve makes hardly less of a surface of one paint, and lengths tell it better. But it can look
    like turned lamps, and of several paints it makes none: then it competes, by agreement alone.
    """
    found = [reading for reading in mistakes if reading.explains_better(own)]
    levelled = evidence.painted is not None
    if found or (levelled and own.agreement <= _LEAST_AGREEMENT):
        other = _read_otherwise(evidence)
        curve = other.transfer.to_text()
        remedy = f"give --transfer {curve} if the rig was calibrated so, else calibrate again"
        read = _Reading.of(f"with the footage read as {curve}", remedy, _own_sums(other))
        mistakes = (*mistakes, replace(read, besides=own.besides))
    if levelled:
        # What errors of levelled paint add agrees with no M, and dilutes all readings alike.
        best = max(reading.agreement for reading in (own, *mistakes))
        sound = min(1.0, max(best, _LEAST_AGREEMENT) / _SOUND)
        own, mistakes = replace(own, sound=sound), tuple(replace(r, sound=sound) for r in mistakes)
    return sorted((r for r in mistakes if r.explains_better(own)), key=lambda reading: reading.misfit)


def _rotation(degrees: float) -> FloatArray:
    cosine, sine = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    return np.array([[cosine, -sine], [sine, cosine]])


def _orders() -> Iterator[tuple[int, ...]]:
    return (order for order in itertools.permutations(range(3)) if order != (0, 1, 2))


def _exchanged(order: tuple[int, ...], names: tuple[str, ...]) -> str:
    moved = [k for k in range(3) if order[k] != k]
    if len(moved) == 2:
        return f"{names[moved[0]]} and {names[moved[1]]} exchanged"
    return f"{names[0]}, {names[1]} and {names[2]} taken for {', '.join(names[k] for k in order)}"


def _finding(own: _Reading, better: list[_Reading]) -> Finding:
    best = better[0]
    alike = (r for r in better[1:3] if r.misfit < best.misfit + _LOG_FACTOR or best.z_above(r) < _Z)
    named = [best, *alike]
    alone = own.front_share < 0.5
    fatal = alone or best.agreement - own.agreement > _FATAL_GAIN
    fits = "; or ".join(f"it is {r.agreement:.2f} {r.name}: {r.remedy}" for r in named)
    measured = (
        f"{1 - own.front_share:.0%} of the lit pixels facing away"
        if alone
        else f"an agreement of mixed derivatives of {own.agreement:.2f} ± {own.standard_error:.2f}"
    )
    level = Level.FATAL if fatal else Level.WARNING
    return Finding.of("matrix", level=level, best=best.name, measured=measured, fits=fits)


def _turn_deg(sums: _Sums) -> tuple[float, float]:
    """Return by how many degrees the lamps stand turned, clockwise in the picture, and its error."""
    rows = np.concatenate([sums.total, sums.left_out])
    angles = np.degrees(np.unwrap(np.arctan2(rows[:, 1], rows[:, 0]))) / 2
    return float(angles[0]), max(0.1, float(jackknife_error(angles[1:])))
