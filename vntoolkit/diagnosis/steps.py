"""What changes from frame to frame that the subject did not: a lamp, exposure, the way round of the picture.

From a frame to the next, the light of a lamp changes in all parts of a picture by one factor if the lamp or
the white balance changes, and here so and there so if the subject moves. The logarithms of the changes are
compared twice by the Bayesian information criterion: those of the parts, a shared change against none, and
those of all frames, some that stand out against one spread. So the noise is the sequence's own. What all
lamps share is exposure, which turns no normal.

Channels that were filmed a frame apart change where the others changed a frame before.

Exposure and white balance that drift change what surrounds the subject and does not move: most of the
picture's border, by one factor. Where the subject fills the picture, or its surroundings are black, this
tells nothing.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations, pairwise

import numpy as np

from vntoolkit.arrays import Float32Array, FloatArray, Mask
from vntoolkit.diagnosis.evidence import CHANNELS, LARGEST_CHANGE, SUBJECT
from vntoolkit.diagnosis.finding import Finding
from vntoolkit.diagnosis.subject import Survey
from vntoolkit.photometry.fit_quality import angles_deg
from vntoolkit.photometry.response import LightResponse

_PARTS = 4  # of the picture, along each side
_ALIKE = 1e-12  # squared light of frames that are the same
_DARKEST = 0.001  # of full scale: a lamp that is out leaves so much
_LIT = 0.02  # of full scale: what is darker may be noise
_SAME_COLOUR = 0.01  # of the light: channels that drift alike, by exposure
_ROUNDING = 0.002  # least spread of log changes: of 8 bits
_FEWEST_CHANGES = 3  # have a spread
_FEWEST_IN_A_ROW = 6  # frames, to tell channels that were filmed apart
_TELLING = 0.05  # of a log: what parts of the picture at rest leave by any lag
_LAGS_TRIED = 6  # pairs of channels, each way round
_FLIPS = {"left and right": (slice(None), slice(None, None, -1)), "top and bottom": (slice(None, None, -1),),
          "by 180 degrees": (slice(None, None, -1),) * 2}  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class LampStep:
    """A lamp that changes from one frame to the next. factor: by which, against the other lamps.

    place: of the first changed frame in the survey. alone: whether the lamp is as before in the next.
    """

    lamp: int
    place: int
    factor: float
    alone: bool


@dataclass(frozen=True, kw_only=True)
class Steps:
    """What changes at once. alike: numbers of the longest run of surveyed frames that were filmed alike."""

    findings: list[Finding]
    alike: list[int]


def steps_of(survey: Survey, response: LightResponse | None = None) -> Steps:
    """Find what changes at once between frames that show the subject.

    response: tells by how much normals turn then; None for unknown.
    """
    seen = np.flatnonzero(survey.shows)
    light = survey.light[seen]
    numbers = [survey.numbers[k] for k in seen]
    steps = list(_lamp_steps(light, survey.lit[seen]))
    flips = dict(_flips(light, numbers))
    findings = []
    for lamp in sorted({step.lamp for step in steps}):
        of_lamp = [step for step in steps if step.lamp == lamp]
        turned = None
        if response is not None:
            lit = survey.lit[seen]
            turned = max(_turned_deg(light[s.place - 1][lit[s.place - 1]], s, response) for s in of_lamp)
        findings.append(_finding_of_lamp(of_lamp, numbers, turned))
    findings += [Finding.of("steps/mirrored", number=numbers[k], how=how) for k, how in flips.items()]
    findings += _findings_of_lag(light, numbers)
    alone = {step.place for step in steps if step.alone}
    cuts = sorted({0, len(numbers), *flips} | {step.place for step in steps if not step.alone})
    runs = [[numbers[k] for k in range(a, b) if k not in alone] for a, b in pairwise(cuts)]
    alike = max(runs, key=len, default=numbers)
    findings += _findings_of_drift(survey.border[np.isin(survey.numbers, alike)], alike)
    return Steps(findings=findings, alike=alike)


def _lamp_steps(light: Float32Array, lit: Mask) -> Iterator[LampStep]:
    """Yield steps. light: (n, v, u, 3). lit: (n, v, u)."""
    if len(light) <= _FEWEST_CHANGES:
        return
    parts = _parts_of(light.shape[1:3])
    changes = [_changes_of_parts(light[k : k + 2], lit[k : k + 2], parts) for k in range(len(light) - 1)]
    shared = np.array([np.median(each, axis=0) if len(each) else np.zeros(3) for each in changes])
    for lamp in range(3):
        places = [
            k
            for k in _standing_out(shared[:, lamp])
            if abs(shared[k, lamp]) > LARGEST_CHANGE
            and abs(shared[k, lamp]) == np.abs(shared[k]).max()  # what one lamp does, the others seem to
            and _is_shared(changes[k][:, lamp], len(shared))
        ]
        ended = set()
        for k in sorted(places):
            if k in ended:
                continue
            after = shared[k : k + 2, lamp].sum() if k + 1 < len(shared) else shared[k, lamp]
            alone = abs(after) < abs(shared[k, lamp]) / 2
            ended.update([k + 1] if alone else [])
            yield LampStep(lamp=lamp, place=k + 1, factor=float(np.exp(shared[k, lamp])), alone=alone)


def _parts_of(shape: tuple[int, ...]) -> FloatArray:
    v, u = np.indices(shape[:2])
    return np.asarray((v * _PARTS // shape[0]) * _PARTS + u * _PARTS // shape[1])


def _changes_of_parts(light: Float32Array, lit: Mask, parts: FloatArray) -> FloatArray:
    """Return log changes (p, 3) of the channels against each other, of parts that all lamps reach."""
    top = np.percentile(light, 99, axis=(1, 2)).max(axis=0)
    reached = (light.max(axis=0) > SUBJECT * top).all(axis=2) & lit.all(axis=0)
    logs = np.log(np.maximum(light, _DARKEST, dtype=np.float64))
    change = (logs[1] - logs[0])[reached]
    change -= np.median(change, axis=1, keepdims=True)
    names = parts[reached]
    return np.array([np.median(change[names == name], axis=0) for name in np.unique(names)]).reshape(-1, 3)


def _standing_out(changes: FloatArray) -> list[int]:
    """Return which of changes (n,) do not belong to the spread of the others.

    The number of them is the best by the criterion: each costs its size and its place.
    """
    order, count = np.argsort(-np.abs(changes)), len(changes)
    left = np.append(np.cumsum((changes[order] ** 2)[::-1])[::-1], 0.0)[: count // 2 + 1]
    least = count * _ROUNDING**2
    each = 0.5 * np.log(count) + np.log(3 * count)
    costs = count / 2 * np.log(np.maximum(left, least)) + each * np.arange(len(left))
    return order[: int(np.argmin(costs))].tolist()


def _is_shared(changes: FloatArray, count: int) -> bool:
    """Tell whether parts (p,) change alike rather than by chance at one of so many places."""
    spread = float(np.sum((changes - changes.mean()) ** 2)) + len(changes) * _ROUNDING**2
    gain = len(changes) / 2 * np.log(np.sum(changes**2) / spread)
    return bool(gain > 0.5 * np.log(len(changes)) + np.log(3 * count))


def _turned_deg(light: Float32Array, step: LampStep, response: LightResponse) -> float:
    """Return the angle between normals of light (n, 3) before a step and after it, median, degrees."""
    after = light.astype(np.float64)
    after[:, step.lamp] *= step.factor
    first, second = ((each - response.ambient) @ response.inverse.T for each in (light, after))
    return float(np.median(angles_deg(first, second))) if len(light) else 0.0


def _finding_of_lamp(of_lamp: list[LampStep], numbers: list[int], turned_deg: float | None) -> Finding:
    """turned_deg: by as much normals turn; None for unknown."""
    shown = [
        f"{step.factor:.2f} times as bright "
        + (f"in frame {at} alone" if step.alone else f"from frame {at} on")
        for step in of_lamp[:4]
        for at in [numbers[step.place]]
    ]
    more = f" and {len(of_lamp) - 4} more" if len(of_lamp) > 4 else ""
    worst = max((step.factor for step in of_lamp), key=lambda factor: abs(np.log(factor)))
    turns = "" if turned_deg is None else f", which turns normals by {turned_deg:.0f} degrees"
    measured = f"{worst:.2f} times the light against the other lamps{turns}"
    channel, changes = CHANNELS[of_lamp[0].lamp], f"{', '.join(shown)}{more}"
    return Finding.of("steps", channel=channel, changes=changes, measured=measured)


def _flips(light: Float32Array, numbers: list[int]) -> Iterator[tuple[int, str]]:
    """Yield the place of a frame that is like the one before only if mirrored, and how.

    As it is, it must differ more than it does mirrored, and more than frames usually do from the next.
    """
    plain = np.sum(np.diff(light, axis=0) ** 2, axis=(1, 2, 3)) + _ALIKE
    usual = float(np.median(plain)) if len(plain) else 0.0
    for k in np.flatnonzero(np.diff(numbers) == 1):
        left = {how: float(np.sum((light[k + 1][flip] - light[k]) ** 2)) for how, flip in _FLIPS.items()}
        how = min(left, key=lambda each: left[each])
        gain = _PARTS**2 / 2 * np.log(plain[k] / max(left[how] + _ALIKE, usual))
        if gain > np.log(len(_FLIPS) * len(light)):
            yield int(k) + 1, how


def _findings_of_lag(light: Float32Array, numbers: list[int]) -> Iterator[Finding]:
    """Find channels that were filmed a frame apart."""
    if len(numbers) < _FEWEST_IN_A_ROW or numbers[-1] - numbers[0] != len(numbers) - 1:
        return
    changes = np.diff(light.astype(np.float64), axis=0)
    parts = _parts_of(light.shape[1:3])
    for first, second in combinations(range(3), 2):
        for sign in (1, -1):
            left = [
                _left_by_lag(changes[..., first], changes[..., second], sign * lag, parts) for lag in range(3)
            ]
            told = np.all([each > 0 for each in left], axis=0)
            same, apart, further = (np.log(each[told]) for each in left)
            if _mostly_more(same - apart) and _mostly_more(further - apart):
                early, late = (first, second) if sign > 0 else (second, first)
                share = np.exp(np.mean(apart - same))
                yield Finding.of("steps/lag", late=CHANNELS[late], early=CHANNELS[early], share=share)


def _findings_of_drift(border: Float32Array, numbers: list[int]) -> list[Finding]:
    """Find exposure or white balance that drifts. border: (n, b, 3), light of the picture's border."""
    seen: Mask = np.asarray((border > _LIT).all(axis=(0, 2)))
    if len(border) < 2 or not seen.any():
        return []
    change = np.log(border[1:, seen] / border[0, seen])
    shared = np.median(change, axis=1)
    still = (np.abs(change - shared[:, None]) < LARGEST_CHANGE).all(axis=(0, 2))
    worst = int(np.abs(shared).max(axis=1).argmax())
    if 2 * np.count_nonzero(still) < len(seen) or np.abs(shared[worst]).max() < LARGEST_CHANGE:
        return []
    red, green, blue = 100 * np.expm1(shared[worst])
    what = "exposure" if np.ptp(shared[worst]) < _SAME_COLOUR else "white balance"
    first, last = numbers[0], numbers[worst + 1]
    return [Finding.of("drift", what=what, first=first, last=last, red=red, green=green, blue=blue)]


def _mostly_more(logs: FloatArray) -> bool:
    """Tell whether parts of the picture (p,) have more left by one lag than by another, not by chance."""
    telling = logs[np.abs(logs) > _TELLING]
    count, more = len(telling), int((telling > 0).sum())
    if 2 * more <= count:
        return False
    shares = np.array([more, count - more]) / count
    gain = count * (np.log(2.0) + float(np.sum(shares * np.log(np.maximum(shares, 1e-12)))))
    return bool(gain > 0.5 * np.log(count) + np.log(_LAGS_TRIED))


def _left_by_lag(first: FloatArray, second: FloatArray, lag: int, parts: FloatArray) -> FloatArray:
    """Return for each part (p,) what changes (n, v, u) of a channel leave of another's that come later."""
    inner = slice(2, len(first) - 2)
    source = first[2 - lag : len(first) - 2 - lag]
    sums = [
        np.bincount(parts.ravel(), np.sum(product, axis=0).ravel())
        for product in (second[inner] ** 2, source * second[inner], source**2)
    ]
    return np.asarray(sums[0] - sums[1] ** 2 / np.maximum(sums[2], 1e-12))
