"""What a dressed garment cannot follow, in every frame: stretched triangles, arms off their sleeves."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from vntoolkit.arrays import BoolArray, FloatArray, IntArray, Points
from vntoolkit.geometry.mesh import Mesh
from vntoolkit.geometry.motion import Skeleton
from vntoolkit.skinning.alignment import SleevedArm
from vntoolkit.skinning.stretch import STRETCHED, edge_lengths, greatest_growth

TORN = 3.0  # shows as a web
_LEAST_VERTICES = 6  # of a sleeve's section, for its motion
_SIDES = {1: "left", -1: "right"}


@dataclass(frozen=True, kw_only=True, eq=False)
class DressingFindings:
    """What was measured of each frame.

    stretched, torn: (frames,) share of triangles of which an edge is longer than 2 and 3 times that of the
    garment at rest. off_axis: (frames, arms, 3) how far elbow, middle of the forearm and wrist are from the
    axis of the sleeve, in its radii; the arms are `sides`. short: arms whose sleeve ends before the wrist, of
    which only the elbow counts, if it reaches so far. has_sleeves: whether such a garment should have them.
    """

    stretched: FloatArray
    torn: FloatArray
    off_axis: FloatArray
    sides: tuple[int, ...]
    short: tuple[bool, ...]
    has_sleeves: bool = True

    @property
    def sentence(self) -> str:
        """One line: where the arms are, and how much the cloth stretches, each with its worst frame."""
        parts = []
        for arm, side in enumerate(self.sides):
            if self.short[arm]:
                parts.append(f"the {_SIDES[side]} sleeve is short")
                continue
            off = self.off_axis[:, arm]
            frame, place = np.unravel_index(int(off.argmax()), off.shape)
            where = ("elbow", "forearm", "wrist")[place]
            most = float(off.max())
            word = "outside" if is_outside(most) else "inside"
            parts.append(
                f"{_SIDES[side]} arm {word} its sleeve ({where} at most {most:.1f} radii off its axis, "
                f"frame {frame})"
            )
        if not parts and self.has_sleeves:
            parts.append("no sleeve found")
        worst = int(self.stretched.argmax())
        parts.append(
            f"{100 * self.stretched.mean():.2f} % of the triangles stretched above {STRETCHED:g}× "
            f"(at most {100 * self.stretched[worst]:.2f} %, frame {worst})"
        )
        return "; ".join(parts)


def is_outside(off_axis: FloatArray | float) -> BoolArray:
    """True where an arm is outside its sleeve by the tenth of a radius that is printed: 1.0 is inside."""
    return np.asarray(np.asarray(off_axis) >= 1.05)  # which is printed as 1.1, and `round` takes for 1.0


class DressingMeter:
    """Measures posed frames of a garment, one after the other."""

    def __init__(
        self,
        rest: Mesh,
        on_figure: Points,
        sleeved: Sequence[SleevedArm],
        skeleton: Skeleton,
        *,
        has_sleeves: bool = True,
    ) -> None:
        """rest: the garment in the pose of attachment. on_figure: (n, 3) before its sleeves were fitted."""
        self._has_sleeves = has_sleeves
        self._faces = rest.faces
        self._lengths = edge_lengths(np.asarray(rest.vertices, dtype=np.float64), rest.faces)
        self._sleeved, self._skeleton = tuple(sleeved), skeleton
        on_figure = np.asarray(on_figure, dtype=np.float64)
        self._sections = [_sections(one, on_figure) for one in sleeved]
        self._stretched: list[float] = []
        self._torn: list[float] = []
        self._off: list[FloatArray] = []

    def stretch(self, vertices: Points) -> FloatArray:
        """Return (m,): how much the most stretched edge of each triangle has grown since the attachment."""
        return greatest_growth(vertices, self._faces, self._lengths)

    def off_axis(self, vertices: Points, pose: FloatArray) -> FloatArray:
        """Return (arms, 3): radii from the axis of the sleeve to elbow, middle of the forearm and wrist."""
        found = np.zeros((len(self._sleeved), 3))
        for arm, (one, sections) in enumerate(zip(self._sleeved, self._sections, strict=True)):
            if len(sections.radii) < 2:
                continue
            axis = sections.moved_axis(vertices)
            _, elbow, wrist = one.arm.points(self._skeleton, pose)
            for place, point in enumerate((elbow, (elbow + wrist) / 2, wrist)):
                found[arm, place] = _off_line(point, axis, sections.radii)
        return found

    def add(self, vertices: Points, pose: FloatArray) -> None:
        """Measure a frame: the garment's vertices (n, 3) and the figure's pose (j, 4, 4)."""
        growth = self.stretch(vertices)
        self._stretched.append(float((growth > STRETCHED).mean()) if len(growth) else 0.0)
        self._torn.append(float((growth > TORN).mean()) if len(growth) else 0.0)
        self._off.append(self.off_axis(vertices, pose))

    @property
    def findings(self) -> DressingFindings:
        """What was measured so far."""
        return DressingFindings(
            stretched=np.array(self._stretched),
            torn=np.array(self._torn),
            off_axis=np.array(self._off).reshape(len(self._off), len(self._sleeved), 3),
            sides=tuple(one.sleeve.side for one in self._sleeved),
            short=tuple(one.is_short for one in self._sleeved),
            has_sleeves=self._has_sleeves,
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class _Sections:
    """The stations of a sleeve that have cloth about them.

    own: (k,) their vertices, station by station. starts: (s,) where each station's begin. centred: (k, 3)
    where they are at first, from the middle of their station. ways: (s, 3) from there to the axis. radii:
    (s,).
    """

    own: IntArray
    starts: IntArray
    centred: Points
    ways: Points
    radii: FloatArray

    def moved_axis(self, vertices: Points) -> Points:
        """Return (s, 3): the axis at each station, moved rigidly with the station's vertices, kabsch1976."""
        now = vertices[self.own].astype(np.float64)
        counts = np.diff(np.append(self.starts, len(self.own)))[:, None]
        middles = np.add.reduceat(now, self.starts) / counts
        products = np.einsum("ki,kj->kij", now, self.centred)  # now need not be centred: the other is
        u, _, vt = np.linalg.svd(np.add.reduceat(products, self.starts))
        u[:, :, 2] *= np.sign(np.linalg.det(u) * np.linalg.det(vt))[:, None]
        return middles + np.einsum("sij,sjk,sk->si", u, vt, self.ways)


def _sections(one: SleevedArm, on_figure: Points) -> _Sections:
    """Return the stations of a sleeve with enough vertices; on_figure: (n, 3)."""
    sleeve, stations = one.sleeve, one.sleeve.stations
    half = sleeve.length / max(len(stations) - 1, 1)
    owned = [np.flatnonzero(np.abs(sleeve.along - station) <= half) for station in stations]
    kept = [k for k, own in enumerate(owned) if len(own) >= _LEAST_VERTICES]
    owned = [owned[k] for k in kept]
    middles = np.array([on_figure[own].mean(axis=0) for own in owned]).reshape(-1, 3)
    sizes = [len(own) for own in owned]
    return _Sections(
        own=np.concatenate([np.zeros(0, np.int64), *owned]),
        starts=np.cumsum([0, *sizes])[:-1],
        centred=np.concatenate([np.zeros((0, 3)), *(on_figure[own] for own in owned)])
        - np.repeat(middles, sizes, axis=0),
        ways=sleeve.axis[kept] - middles,
        radii=sleeve.radii[kept],
    )


def _off_line(point: Points, line: Points, radii: FloatArray) -> float:
    """Return the distance from a point to a polyline, over the radius where it is nearest."""
    starts, ways = line[:-1], np.diff(line, axis=0)
    along = np.sum((point - starts) * ways, axis=1) / np.maximum(np.sum(ways**2, axis=1), 1e-300)
    along = np.clip(along, 0, 1)
    gaps = np.linalg.norm(point - starts - along[:, None] * ways, axis=1)
    nearest = int(gaps.argmin())
    radius = (1 - along[nearest]) * radii[nearest] + along[nearest] * radii[nearest + 1]
    return float(gaps[nearest] / max(radius, 1e-300))
