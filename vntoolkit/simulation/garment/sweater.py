"""The scene `sweater`: a knitted sweater on a dancer, folds that open and close (Figures 9, 10).

`sweater_stripes`, `sweater_logo` and `sweater_tartan` are the same sweater in several colours.
"""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy import sparse
from scipy.ndimage import gaussian_filter

from vntoolkit.arrays import Faces, FloatArray, IntArray, Points, Points2
from vntoolkit.geometry.mesh import vertex_normals
from vntoolkit.options.simulation import SceneOptions
from vntoolkit.simulation.garment.solver import THICKNESS_M, Capsules, ClothSolver, Garment
from vntoolkit.simulation.lights import FRAME_RATE_HZ, studio_camera, studio_centre
from vntoolkit.simulation.scene import Detail, Scene, SceneSurface
from vntoolkit.simulation.shapes import read_shape, smooth_step

_FRAMES = 1000
_FIELD_WIDTH_M = 1.42
_MIDDLE_M = np.array([0.0, -0.36, 0.0])  # of the sweater, below the throat: what the camera looks at
_LEVELS = 2
# the pattern's shoulder point; how far its sleeves, and the arms at rest, fall below the horizontal
SHOULDER_M, SLEEVE_DROP_DEG = np.array([0.215, -0.035]), 25.0
_WOOL = np.array([0.66, 0.63, 0.58])
_NAVY, _RED = np.array([0.20, 0.25, 0.46]), np.array([0.60, 0.19, 0.17])
_YELLOW, _GREEN = np.array([0.66, 0.53, 0.16]), np.array([0.20, 0.42, 0.24])
_STRIPE_M = 0.07
_LOGO_MIDDLE_M, _LOGO_RADIUS_M = np.array([0.0, -0.27]), 0.14
_SETT_M = np.array([0.065, 0.05, 0.025])  # widths of the tartan's bands: red, green, navy
_PRINT_TEXEL_M = 0.001
_SETTLE_FRAMES, _HANG_FRAMES, _FADE_FRAMES = 30, 30, 75
STITCH_M = (0.011, 0.0095)  # width and height of one stitch
_CABLE_SPACING_M, _CABLE_TWIST_M = 0.066, 0.070
_STRAND_SHIFT_M, _STRAND_WIDTH_M = 0.0085, 0.0065
_CABLE_HEIGHT_M, _RIB_HEIGHT_M, _RIB_SPACING_M = 0.0032, 0.0016, 0.0135
_STITCH_HEIGHT_M = 0.00045
_YARN_SPREAD = 0.05
# height of a section below the throat, half its span, radius at its ends
_SEAT = (-0.85, 0.085, 0.100)
_HIPS = (-0.60, 0.085, 0.105)
_WAIST = (-0.40, 0.065, 0.088)
_CHEST = (-0.19, 0.080, 0.105)
_SHOULDERS = (-0.075, 0.110, 0.068)
_TORSO = (_SEAT, _HIPS, _WAIST, _CHEST, _SHOULDERS)
_UPPER_ARM_M, _FOREARM_M = 0.29, 0.25
_ARM_RADII = (0.056, 0.042, 0.030)
_TEMPO = 0.85  # slows the whole dance; the frequencies below are those at 1


def build_sweater(options: SceneOptions) -> Scene:
    """Return 1000 frames of the dancing sweater; frames are simulated as they are asked for."""
    return _dancing("sweater", options, None)


def build_striped_sweater(options: SceneOptions) -> Scene:
    """Return the same sweater with stripes of navy."""
    return _dancing("sweater_stripes", options, _stripes)


def build_sweater_with_logo(options: SceneOptions) -> Scene:
    """Return the same sweater with a round logo of four colours on the chest."""
    return _dancing("sweater_logo", options, _logo)


def build_tartan_sweater(options: SceneOptions) -> Scene:
    """Return the same sweater in a tartan of three yarns; where two cross, their colours mix."""
    return _dancing("sweater_tartan", options, _tartan)


def _dancing(
    name: str, options: SceneOptions, print_at: Callable[[FloatArray, FloatArray], FloatArray] | None
) -> Scene:
    rng = np.random.default_rng(options.seed + 1)
    sewn = read_sweater()
    garment = DancingGarment(options.seed, sewn)
    faces, flat, gather = sewn.faces, sewn.flat, sewn.gather
    refine = None
    for _ in range(_LEVELS):
        smooth, halve, faces = loop_subdivision(faces, len(flat))
        flat, gather = halve @ flat, halve @ gather
        refine = smooth if refine is None else smooth @ refine
    relief = knit_relief(knit_coordinates(flat), gather)
    stitches = 1.0 / np.array(STITCH_M)
    texture, uv, uv_per_m = heather_texture(rng), 4.0 * flat, np.full(2, 4.0)
    if print_at is not None:
        low, extent = flat.min(axis=0), np.ptp(flat, axis=0)
        texture, uv, uv_per_m = _printed(texture, print_at, low, extent), (flat - low) / extent, 1.0 / extent
    surface = SceneSurface(
        faces=faces,
        reference_weights=0.95 * _WOOL,
        vertex_weights=np.tile(_WOOL, (len(flat), 1)) if print_at is None else None,
        texture=texture,
        uv=uv[faces],
        detail=Detail(height_m=stitch_tile(), repeats=(stitches[0] / uv_per_m[0], stitches[1] / uv_per_m[1])),
    )
    return Scene(
        name=name,
        camera=studio_camera(options, _FIELD_WIDTH_M),
        surface=surface,
        vertices=_refined(garment, refine, faces, relief),
        frame_count=_FRAMES,
    )


def read_sweater() -> Garment:
    """Read the sewn sweater that the package ships: two panels, joined along sides and sleeves."""
    shape = read_shape("sweater")
    return Garment(**{name: shape[name] for name in ("flat", "gather", "panel", "faces")})


def _printed(
    heather: FloatArray,
    print_at: Callable[[FloatArray, FloatArray], FloatArray],
    low: FloatArray,
    extent: FloatArray,
) -> FloatArray:
    """Return (th, tw, 3), the print over the whole pattern times the yarn's uneven dye."""
    columns, rows = np.ceil(extent / _PRINT_TEXEL_M).astype(int)
    x = low[0] + (np.arange(columns) + 0.5) * extent[0] / columns
    y = low[1] + (np.arange(rows) + 0.5) * extent[1] / rows
    size = len(heather)
    u = np.floor(4.0 * size * x).astype(int) % size
    v = np.floor(4.0 * size * y).astype(int) % size
    return np.asarray(print_at(*np.meshgrid(x, y)) * heather[np.ix_(v, u)], dtype=np.float32)


def _stripes(x: FloatArray, y: FloatArray) -> FloatArray:
    return np.where((np.floor(y / _STRIPE_M) % 2 == 0)[..., None], _WOOL, _NAVY)


def _logo(x: FloatArray, y: FloatArray) -> FloatArray:
    across, up = x - _LOGO_MIDDLE_M[0], y - _LOGO_MIDDLE_M[1]
    quarter = 2 * (across > 0) + (up > 0)
    inside = np.hypot(across, up) < _LOGO_RADIUS_M
    return np.where(inside[..., None], np.stack([_RED, _YELLOW, _GREEN, _NAVY])[quarter], _WOOL)


def _tartan(x: FloatArray, y: FloatArray) -> FloatArray:
    yarns = np.stack([_RED, _GREEN, _NAVY])
    ends = np.cumsum(_SETT_M)
    warp, weft = (yarns[np.searchsorted(ends, at % ends[-1], side="right")] for at in (x, y))
    return np.asarray(0.5 * (warp + weft))


def _refined(
    garment: "DancingGarment", refine: object, faces: Faces, relief: FloatArray
) -> Callable[[int], Points]:
    """Return the function from frame to dense vertices in the camera frame."""

    def vertices(frame: int) -> Points:
        fine = refine @ garment.cage(frame)  # type: ignore[operator]
        raised = fine + relief[:, None] * vertex_normals(fine, faces)
        return (raised - _MIDDLE_M) * [1.0, -1.0, -1.0] + studio_centre()

    return vertices


class DancingGarment:
    """The coarse cage of the garment at any frame; holds one state only.

    A later frame is simulated from the current one; an earlier one starts again from the beginning. The
    same seed gives the same bytes.
    """

    def __init__(self, seed: int, garment: Garment, thickness_m: float = THICKNESS_M) -> None:
        self.garment = garment
        self._thickness_m = thickness_m
        self._phases = np.random.default_rng(seed).uniform(0.0, 2.0 * np.pi, 8)
        self._solver: ClothSolver | None = None  # dressed when the first frame is asked for
        self._frame = -_FADE_FRAMES

    @property
    def solver(self) -> ClothSolver:
        """The solver in its current state."""
        if self._solver is None:
            self._solver = self._dressed()
            self._frame = -_FADE_FRAMES
        return self._solver

    def body(self, frame: int) -> Capsules:
        """Return the dancer's body; before frame 0 it fades in from the rest pose."""
        fade = float(smooth_step((frame + _FADE_FRAMES) / _FADE_FRAMES))
        return body_from_pose(pose_at(frame / FRAME_RATE_HZ, self._phases, fade))

    def cage(self, frame: int) -> Points:
        """Return (n, 3) the garment's vertices, studio frame of the body, metres."""
        if self._solver is not None and frame < self._frame:
            self._solver = None
        solver = self.solver
        while self._frame < frame:
            solver.advance(self.body(self._frame), self.body(self._frame + 1))
            self._frame += 1
        return solver.positions.copy()

    def _dressed(self) -> ClothSolver:
        body = body_from_pose(Pose())
        solver = ClothSolver(self.garment, body, self._thickness_m)
        for _ in range(_SETTLE_FRAMES):
            solver.settle(body)
        for frame in range(_HANG_FRAMES):
            solver.draw_ribbing((frame + 1) / _HANG_FRAMES)
            solver.advance(body, body)
        return solver


def knit_coordinates(flat: Points2) -> Points2:
    """Return (n, 2) metres across and along the ribs: upright on the body, lengthwise on the sleeves."""
    drop = np.deg2rad(SLEEVE_DROP_DEG)
    folded = np.stack([np.abs(flat[:, 0]), flat[:, 1]], axis=1) - SHOULDER_M
    along = folded @ [np.cos(drop), -np.sin(drop)]
    across = folded @ [-np.sin(drop), -np.cos(drop)]
    on_sleeve = folded[:, 0] > 0.02 - 0.25 * folded[:, 1]  # beyond the armhole
    return np.where(on_sleeve[:, None], np.stack([across, along], axis=1), flat)


def knit_relief(along_knit: Points2, gather: FloatArray) -> FloatArray:
    """Return (n,) metres by which cables and ribs stand out; along_knit: (n, 2) across and along the ribs."""
    x = along_knit[:, 0]
    offset = x - _CABLE_SPACING_M * np.round(x / _CABLE_SPACING_M)
    swing = _STRAND_SHIFT_M * np.sin(2.0 * np.pi * along_knit[:, 1] / _CABLE_TWIST_M)
    strands = [np.exp(-0.5 * ((offset - s * swing) / (0.5 * _STRAND_WIDTH_M)) ** 2) for s in (-1.0, 1.0)]
    cables = _CABLE_HEIGHT_M * np.maximum(*strands)
    ribs = _RIB_HEIGHT_M * np.cos(2.0 * np.pi * x / _RIB_SPACING_M)
    band = np.clip((1.0 - gather) / max(1.0 - float(gather.min()), 1e-9), 0.0, 1.0)
    return np.asarray((1.0 - band) * cables + band * ribs)


def stitch_tile() -> FloatArray:
    """Return (48, 48) the height of one stitch, metres: two yarns that lean into a V, tiling."""
    v, u = np.meshgrid(*(2 * [(np.arange(48) + 0.5) / 48]), indexing="ij")
    height = np.zeros(u.shape)
    for sign in (-1.0, 1.0):
        for row in (-1.0, 0.0, 1.0):
            along = v - row - 0.5
            across = (u - 0.5) - sign * (0.24 - 0.16 * along)
            yarn = np.exp(-0.5 * (across / 0.13) ** 2 - 0.5 * (along / 0.34) ** 2)
            height = np.maximum(height, yarn)
    return np.asarray(_STITCH_HEIGHT_M * height)


def heather_texture(rng: np.random.Generator) -> FloatArray:
    """Return (256, 256, 3) factors near 1: the yarn's uneven dye, without a change of hue, tiling."""
    noise = np.zeros((256, 256))
    for blur in (0.8, 2.5, 7.0):
        layer = gaussian_filter(rng.standard_normal(noise.shape), (blur, 1.6 * blur), mode="wrap")
        noise += layer / layer.std()
    factor = 1.0 - _YARN_SPREAD + _YARN_SPREAD * np.tanh(noise / noise.std())
    return np.repeat(factor[..., None], 3, axis=2).astype(np.float32)


def loop_subdivision(faces: Faces, count: int) -> tuple[sparse.csr_matrix, sparse.csr_matrix, Faces]:
    """Split every face in four.

    Returns S (n', n) with refined = S @ vertices, the plain mid-point matrix of the same shape (for texture
    coordinates), and the finer faces. Rims follow the cubic B-spline of their own points.
    """
    corners = faces.astype(np.int64)
    directed = np.concatenate([corners[:, [0, 1]], corners[:, [1, 2]], corners[:, [2, 0]]])
    opposite = np.concatenate([corners[:, 2], corners[:, 0], corners[:, 1]])
    edges, number, times = np.unique(
        np.sort(directed, axis=1), axis=0, return_inverse=True, return_counts=True
    )
    number = number.ravel()
    on_rim = times == 1
    midpoints = count + number.reshape(3, -1)
    a, b, c = corners.T
    ab, bc, ca = midpoints
    finer = np.concatenate(
        [np.stack(t, axis=1) for t in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))]
    ).astype(np.int32)
    smooth = sparse.vstack(
        [_old_points(edges, on_rim, count), _edge_points(edges, number, opposite, on_rim, count)]
    )
    rows = np.repeat(np.arange(len(edges)), 2)
    halves = sparse.csr_matrix(
        (np.full(2 * len(edges), 0.5), (rows, edges.ravel())), shape=(len(edges), count)
    )
    return smooth.tocsr(), sparse.vstack([sparse.eye(count), halves]).tocsr(), finer


def _old_points(edges: IntArray, on_rim: IntArray, count: int) -> sparse.csr_matrix:
    """Return (n, n) the weights of the moved old points."""
    rim = np.zeros(count, dtype=bool)
    rim[edges[on_rim]] = True
    ends = np.concatenate([edges, edges[:, ::-1]])
    along_rim = np.tile(on_rim, 2)
    degree = np.bincount(ends[:, 0], minlength=count)
    beta = np.where(degree == 3, 3.0 / 16.0, 3.0 / (8.0 * np.maximum(degree, 1)))
    weight = np.where(rim[ends[:, 0]], np.where(along_rim, 0.125, 0.0), beta[ends[:, 0]])
    matrix = sparse.csr_matrix((weight, (ends[:, 0], ends[:, 1])), shape=(count, count))
    matrix.eliminate_zeros()
    return matrix + sparse.diags(1.0 - np.asarray(matrix.sum(axis=1)).ravel())


def _edge_points(
    edges: IntArray, number: IntArray, opposite: IntArray, on_rim: IntArray, count: int
) -> sparse.csr_matrix:
    """Return (e, n) the weights of the new points on the edges."""
    row = np.arange(len(edges))
    near = np.where(on_rim, 0.5, 0.375)
    inner = ~on_rim[number]
    rows = np.concatenate([row, row, number[inner]])
    columns = np.concatenate([edges[:, 0], edges[:, 1], opposite[inner]])
    weights = np.concatenate([near, near, np.full(np.count_nonzero(inner), 0.125)])
    return sparse.csr_matrix((weights, (rows, columns)), shape=(len(edges), count))


@dataclass(frozen=True, kw_only=True)
class Pose:
    """One posture; angles in radians, shifts in metres.

    shift: (x, y, z) of the hips. hip_turn, chest_turn: about the vertical. bend: of the chest to the side.
    arm_drop, arm_forward, elbow: (left in the image, right in the image) below the horizontal, towards the
    viewer, bend of the elbow.
    """

    shift: tuple[float, float, float] = (0.0, 0.0, 0.0)
    hip_turn: float = 0.0
    chest_turn: float = 0.0
    bend: float = 0.0
    arm_drop: tuple[float, float] = (np.deg2rad(SLEEVE_DROP_DEG), np.deg2rad(SLEEVE_DROP_DEG))
    arm_forward: tuple[float, float] = (0.0, 0.0)
    elbow: tuple[float, float] = (0.0, 0.0)


# A dancer's upper body: tapered capsules whose joints follow a smooth, seeded choreography.


def body_from_pose(pose: Pose) -> Capsules:
    """Return the body in that pose; the capsules keep their order and radii."""
    sections = [_section(pose, index) for index in range(len(_TORSO))]
    starts: list[FloatArray] = []
    ends: list[FloatArray] = []
    radii: list[tuple[float, float]] = []
    for centre, half, radius in sections:
        starts.append(centre - half)
        ends.append(centre + half)
        radii.append((radius, radius))
    for (low, low_half, low_r), (high, high_half, high_r) in pairwise(sections):
        for side in (-1.0, 0.0, 1.0):
            starts.append(low + side * low_half)
            ends.append(high + side * high_half)
            radii.append((low_r, high_r))
    for joints in (_arm(pose, 0, sections[-1]), _arm(pose, 1, sections[-1])):
        for i in range(2):
            starts.append(joints[i])
            ends.append(joints[i + 1])
            radii.append((_ARM_RADII[i], _ARM_RADII[i + 1]))
    throat = sections[-1][0]
    up = throat - sections[-2][0]
    starts.append(throat)
    ends.append(throat + up / np.linalg.norm(up) * 0.16)
    radii.append((0.055, 0.052))
    return Capsules(starts=np.array(starts), ends=np.array(ends), radii=np.array(radii))


def pose_at(time_s: float, phases: FloatArray, amount: float = 1.0) -> Pose:
    """Return the choreography at a time; `amount` fades from the rest pose (0) to the dance (1).

    phases: (8,) radians, the dancer's own.
    """
    swing = 2.0 * np.pi * _TEMPO * time_s

    def wave(hertz: float, index: int) -> float:
        return float(np.sin(swing * hertz + phases[index]))

    turn = 0.36 * wave(0.37, 0) + 0.07 * wave(0.92, 1)
    rest = np.deg2rad(SLEEVE_DROP_DEG)
    drop = [0.74 + 0.24 * wave(0.46, 2 + side) + 0.06 * wave(0.92, 4 + side) for side in (0, 1)]
    forward = [0.12 + 0.22 * wave(0.53, 5 - side) for side in (0, 1)]
    elbow = [0.26 + 0.14 * wave(0.46, 6 + side) for side in (0, 1)]
    return Pose(
        shift=(
            amount * 0.055 * wave(0.46, 1),
            amount * (0.010 * wave(1.84, 1) - 0.005),
            amount * 0.03 * wave(0.31, 3),
        ),
        hip_turn=amount * (-0.16 * wave(0.37, 0) + 0.10 * wave(0.46, 4)),
        chest_turn=amount * turn,
        bend=amount * 0.13 * wave(0.46, 1),
        arm_drop=(rest + amount * (drop[0] - rest), rest + amount * (drop[1] - rest)),
        arm_forward=(amount * forward[0], amount * forward[1]),
        elbow=(amount * elbow[0], amount * elbow[1]),
    )


def _section(pose: Pose, index: int) -> tuple[FloatArray, FloatArray, float]:
    """Return centre, half span (3,) and radius of a torso section; turn and bend grow from hips to chest."""
    height, span, radius = _TORSO[index]
    share = (height - _HIPS[0]) / (_CHEST[0] - _HIPS[0])
    share = float(np.clip(share, 0.0, 1.0))
    turn = pose.hip_turn + share * (pose.chest_turn - pose.hip_turn)
    lean = pose.bend * share
    above = height - _HIPS[0]
    upwards = np.array([above * np.sin(lean), _HIPS[0] + above * np.cos(lean), 0.0])
    centre = np.array(pose.shift) + upwards
    level = np.array([np.cos(lean), -np.sin(lean), 0.0])
    half = span * (np.cos(turn) * level - np.sin(turn) * np.array([0.0, 0.0, 1.0]))
    return centre, half, radius


def _arm(pose: Pose, side: int, shoulders: tuple[FloatArray, FloatArray, float]) -> Points:
    """Return shoulder, elbow and wrist (3, 3)."""
    centre, half, _ = shoulders
    across = half / np.linalg.norm(half) * (1.0 if side else -1.0)
    front = np.cross(half, [0.0, 1.0, 0.0])
    front /= np.linalg.norm(front)
    drop, forward, elbow = pose.arm_drop[side], pose.arm_forward[side], pose.elbow[side]
    reach = np.cos(drop) * (np.cos(forward) * across + np.sin(forward) * front)
    upper = reach - np.sin(drop) * np.array([0.0, 1.0, 0.0])
    target = 0.5 * front + 0.7 * np.array([0.0, 1.0, 0.0]) + 0.2 * across
    bend = target - (target @ upper) * upper
    bend /= np.linalg.norm(bend)
    shoulder = centre + 1.45 * half * (1.0 if side else -1.0)
    joint = shoulder + _UPPER_ARM_M * upper
    return np.stack([shoulder, joint, joint + _FOREARM_M * (np.cos(elbow) * upper + np.sin(elbow) * bend)])
