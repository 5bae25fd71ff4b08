"""Pose of what touches a gel, frame by frame, its shape not known before: normals and depth are aligned.

In contact the gel has the object's surface. A rigid motion ξ = (ω, τ) of the object moves a point q by
d = ω × q + τ, turns its normal n by ω × n, and carries the normals of the picture along: at a fixed pixel
they change by ω × n − (d · ∇) n. Depth changes by d along the normal. Gauss–Newton steps solve both for ξ,
from the pose of the frame before (normal flow, huang2024). The normals tell all but the motion along the
line of sight, which the mean depth of the contact tells.

Frames are aligned to a keyframe: the one of which most is in contact now. Where less than half of every one
is, the frame before becomes one. An object that rolls back meets the keyframes of its way again, so that what
has drifted goes.

A ball turns about its middle, and no normal changes, but for noise, which looks like information. Two frames
share the surface and not the noise. So the information matrix of one frame's gradients is compared with that
of one times the other's. A direction of which less than half of the information is left is reported as
unobservable, and the object is taken not to have moved along it.
"""

from dataclasses import dataclass
from typing import NamedTuple, Protocol

import cv2
import numpy as np
from scipy.linalg import eigh

from vntoolkit.arrays import Array, FloatArray, Mask, Normals, Points, Vector3
from vntoolkit.geometry.camera import Camera
from vntoolkit.geometry.rigid import RigidTransform
from vntoolkit.spread import NINE_OF_TEN_IN_PLANE, NINE_OF_TEN_IN_SPACE

_SAMPLES = 1500  # pixels of a keyframe's contact: more refine nothing
_STEPS, _SETTLED = 20, 1e-3  # Gauss–Newton steps; share of the misfit that the last of them takes off
_BLOCK_PX = 8  # errors within such a square go together: fits of the gel's colours bend so finely
_FEWEST_BLOCKS = 6  # of a contact, to tell six directions
_SHARED = 0.5  # of a contact that must be seen in the keyframe
_STEP_PX = 2  # over which gradients are taken, on both sides
_SMOOTH_PX = 1.0  # standard deviation of the blur of normals: noise of single pixels has no gradient
_RELIABLE = 0.5  # share of a direction's information that two frames agree on: the rest is noise
_SOFT = 2.0  # standard deviations beyond which residuals count less (Cauchy's weight)
_LEAST_NOISE = 1e-3  # of a normal: single precision and bytes leave no less
_HERE = np.zeros(3)


class Touched(Protocol):
    """What of a `Touch` is needed: (h, w) maps of one frame."""

    @property
    def normals(self) -> Normals:
        """(h, w, 3) unit vectors, camera frame."""

    @property
    def depth_mm(self) -> FloatArray:
        """0 at rest, negative in a dent."""

    @property
    def contact(self) -> Mask:
        """True where something touches."""

    @property
    def error_mm(self) -> FloatArray | None:
        """What nine of ten depths stay within."""


@dataclass(frozen=True, kw_only=True, eq=False)
class TrackedPose:
    """Where the object is in one frame.

    now_from_first: from where it was in the first frame of its contact; camera frame, millimetres, the origin
    on the optical axis at the gel's rest. contact: counts the contacts; poses of one compare. lost: the
    contact is too small, or nothing of it was seen before; the pose is then the last known. error_deg,
    error_mm: what nine of ten turns, and positions of the contact's middle, stay within, along the directions
    that are observable. unobservable: (k, 6), unit motions (ω in radians, τ in contact radii) about the
    contact's middle. information: (5,), the share of each direction's that two frames agree on, ascending;
    the sixth direction, along the line of sight, the depth tells.
    keyframe: the number it was aligned to.
    """

    now_from_first: RigidTransform
    contact: int
    lost: bool
    error_deg: float
    error_mm: float
    unobservable: FloatArray
    information: FloatArray
    keyframe: int


class _Keyframe(NamedTuple):
    """Samples of a contact. points: (n, 3), mm. normals: (n, 3), with their gradients (n, 3, 2) per mm.

    pose: now_from_first of that frame; covariance: (6, 6) of its error. size: pixels of the contact.
    """

    points: Points
    normals: Points
    gradients: FloatArray
    blocks: Array
    pose: RigidTransform
    covariance: FloatArray
    size: int


class _View(NamedTuple):
    """One frame as it is sampled. normals: (h, w, 3), smooth. more: (h, w, 2), depth, contact. size: pixels
    of the contact."""

    normals: Array
    more: Array
    contact: Mask
    size: int


class _Aligned(NamedTuple):
    """covariance: (6, 6) of the error. unobservable, information: as of `TrackedPose`."""

    now_from_key: RigidTransform
    covariance: FloatArray
    unobservable: FloatArray
    information: FloatArray


class ObjectPose:
    """Follows one object on a gel; frames come in order. `pose = ObjectPose(gel.rig.camera)(touch)`."""

    def __init__(self, camera: Camera) -> None:
        """camera: of the rectified gel, orthographic, metres."""
        self._pixel_mm = 1000.0 / float(camera.matrix[0, 0])
        self._centre_px = np.array(camera.matrix[:2, 2], dtype=np.float64)
        self._keyframes: list[_Keyframe] = []
        self._before: _Keyframe | None = None
        self._pose, self._contacts = RigidTransform(), 0

    def __call__(self, touch: Touched) -> TrackedPose:
        """Return the pose of what touches the gel in the next frame."""
        view = _view(touch)
        if len(np.unique(_blocks_of(*np.nonzero(view.contact)))) < _FEWEST_BLOCKS:
            self._before = None
            return self._result(lost=True)
        if self._before is None:
            return self._begun(view)
        shared = [self._shared_now(key, view) for key in self._keyframes]
        if max(shared) < _SHARED:
            self._keyframes.append(self._before)
            shared.append(self._shared_now(self._before, view))
        chosen = int(np.argmax(shared))
        key = self._keyframes[chosen]
        if shared[chosen] < _SHARED:
            return self._begun(view, lost=True)
        depth_error = 0.0 if touch.error_mm is None else float(np.median(touch.error_mm[view.contact]))
        start, deviation = self._pose @ key.pose.inverse(), depth_error / NINE_OF_TEN_IN_PLANE
        aligned = self._aligned(key, view, start, deviation)
        if aligned is None:
            return self._begun(view, lost=True)
        self._pose = aligned.now_from_key @ key.pose
        covariance = key.covariance + aligned.covariance
        self._before = self._keyframe(view, covariance)
        return self._result(
            covariance=covariance,
            unobservable=aligned.unobservable,
            information=aligned.information,
            keyframe=chosen,
        )

    def _begun(self, view: _View, *, lost: bool = False) -> TrackedPose:
        """Start a contact: its first frame is where poses are told from."""
        self._contacts += 1
        self._pose = RigidTransform()
        self._before = self._keyframe(view, np.zeros((6, 6)))
        self._keyframes = [self._before]
        return self._result(lost=lost)

    def _result(
        self,
        *,
        lost: bool = False,
        covariance: FloatArray | None = None,
        unobservable: FloatArray | None = None,
        information: FloatArray | None = None,
        keyframe: int = 0,
    ) -> TrackedPose:
        error = np.full(2, np.inf) if lost else np.zeros(2)
        if covariance is not None:
            turn, shift = covariance[:3, :3].trace(), covariance[3:, 3:].trace()
            error = NINE_OF_TEN_IN_SPACE / np.sqrt(3.0) * np.sqrt(np.array([turn, shift]))
        return TrackedPose(
            now_from_first=self._pose,
            contact=self._contacts,
            lost=lost,
            error_deg=float(np.degrees(error[0])),
            error_mm=float(error[1]),
            unobservable=np.zeros((0, 6)) if unobservable is None else unobservable,
            information=np.full(5, np.nan) if information is None else information,
            keyframe=keyframe,
        )

    def _keyframe(self, view: _View, covariance: FloatArray) -> _Keyframe:
        v, u = np.nonzero(view.contact)
        step = max(1, -(-len(u) // _SAMPLES))
        v, u = v[::step], u[::step]
        normals = view.normals
        ramp = np.zeros((2 * _STEP_PX + 1, 1))
        ramp[0], ramp[-1] = -1.0, 1.0
        slopes = [cv2.filter2D(normals, -1, kernel)[v, u] for kernel in (ramp.T, ramp)]
        gradients = np.stack(slopes, axis=-1) / (2.0 * _STEP_PX * self._pixel_mm)
        flat = (np.column_stack([u, v]) - self._centre_px) * self._pixel_mm
        return _Keyframe(
            points=np.column_stack([flat, view.more[v, u, 0]]).astype(np.float64),
            normals=normals[v, u].astype(np.float64),
            gradients=gradients.astype(np.float64),
            blocks=_blocks_of(v, u),
            pose=self._pose,
            covariance=covariance,
            size=view.size,
        )

    def _seen(self, key: _Keyframe, view: _View, now: RigidTransform, off_mm: Array = _HERE) -> FloatArray:
        """What the frame shows, (n, 5), where the samples of a keyframe are now, beside there by `off_mm`."""
        places = now.apply(key.points + off_mm)[:, None, :2] / self._pixel_mm + self._centre_px
        u, v = np.moveaxis(places.astype(np.float32), -1, 0)
        seen = [cv2.remap(each, u, v, cv2.INTER_LINEAR) for each in (view.normals, view.more)]
        return np.concatenate(seen, axis=-1)[:, 0].astype(np.float64)

    def _shared_now(self, key: _Keyframe, view: _View) -> float:
        """The share of the smaller contact that both have, in the pose of the frame before."""
        return _shared(key, view, self._seen(key, view, self._pose @ key.pose.inverse()))

    def _aligned(
        self, key: _Keyframe, view: _View, start: RigidTransform, depth_error_mm: float
    ) -> _Aligned | None:
        """Align a frame to a keyframe; None where little of the contact ends up in common."""
        middle = key.points.mean(axis=0)
        radius = float(np.sqrt(((key.points - middle) ** 2).sum(axis=1).mean()))
        design, depth_row = _design(key, middle, radius), _depth_row(key, middle, radius)
        now, seen = start, self._seen(key, view, start)
        for _ in range(_STEPS):
            residual, weight = _residual(key, seen, now)
            normal = _product(design, weight, design)
            right = _product(design, weight, residual)[:, 0]
            step = _with_depth(normal, right, depth_row, _depth_off(key, seen, now, weight))
            now = now @ _motion(step, middle, radius)
            seen = self._seen(key, view, now)
            if _shared(key, view, seen) < _SHARED / 2:  # half of what it began with
                return None
            misfit = float(weight @ (residual**2).sum(axis=1))
            if step[:5] @ right[:5] < _SETTLED * misfit:  # what noise alone moves takes off next to nothing
                break
        residual, weight = _residual(key, seen, now)
        agreed = self._agreement(key, view, now, design, weight, middle, radius)
        normal = _product(design, weight, design)[:5, :5]
        values, directions = eigh(agreed[:5, :5], normal + 1e-9 * np.trace(normal) * np.eye(5))
        kept = values > _RELIABLE
        moved = _parameters(start.inverse() @ now, middle, radius)
        # Directions are orthogonal in the information: what is not observable did not move.
        inverse = np.linalg.inv(directions)
        moved[:5] = directions[:, kept] @ (inverse[kept] @ moved[:5])
        now = start @ _motion(moved, middle, radius)
        off = _depth_off(key, self._seen(key, view, now), now, weight)
        along = np.zeros(6)
        along[5] = off / radius / float(np.average(key.normals[:, 2], weights=weight))
        now = now @ _motion(along, middle, radius)
        covariance = self._covariance(
            key, design, weight, residual, directions[:, kept] / np.sqrt(values[kept])
        )
        covariance[5, 5] += (depth_error_mm / radius) ** 2
        unit = directions / np.linalg.norm(directions, axis=0)
        scale = np.array([1.0, 1, 1, radius, radius, radius])
        return _Aligned(
            now_from_key=now,
            covariance=covariance * np.outer(scale, scale),
            unobservable=np.pad(unit[:, ~kept].T, ((0, 0), (0, 1))),
            information=values,
        )

    def _agreement(
        self,
        key: _Keyframe,
        view: _View,
        now: RigidTransform,
        design: FloatArray,
        weight: FloatArray,
        middle: Vector3,
        radius: float,
    ) -> FloatArray:
        """How much frames agree on what each direction does: `design` times that of this frame's gradients.

        Noise, which two frames do not share, is not in it.
        """
        slopes = []
        for axis in range(2):
            off = _STEP_PX * self._pixel_mm * np.eye(3)[axis]
            ahead, behind = (self._seen(key, view, now, sign * off)[:, :3] for sign in (1, -1))
            slopes.append((ahead - behind) / (2.0 * off[axis]) @ now.rotation)
        again = _design(key._replace(gradients=np.stack(slopes, axis=-1)), middle, radius)
        both = _product(design, weight, again)
        return np.asarray((both + both.T) / 2.0)

    def _covariance(
        self, key: _Keyframe, design: FloatArray, weight: FloatArray, residual: FloatArray, basis: FloatArray
    ) -> FloatArray:
        """(6, 6) of the error, in observable directions: errors within a block may all go together."""
        scores = (design * (weight[:, None] * residual)[..., None]).sum(axis=1)
        _, block = np.unique(key.blocks, return_inverse=True)
        sums = np.zeros((block.max() + 1, scores.shape[1]))
        np.add.at(sums, block, scores)
        information = _product(design, weight, design)[:5, :5]
        own = basis @ np.linalg.solve(basis.T @ information @ basis, basis.T)
        covariance = np.zeros((6, 6))
        covariance[:5, :5] = own @ (sums.T @ sums)[:5, :5] @ own
        return covariance


def _view(touch: Touched) -> _View:
    normals = cv2.GaussianBlur(np.asarray(touch.normals, np.float32), (0, 0), _SMOOTH_PX)
    more = np.stack([touch.depth_mm, touch.contact], axis=-1).astype(np.float32)
    contact = np.asarray(touch.contact)
    return _View(normals, more, contact, int(np.count_nonzero(contact)))


def _blocks_of(rows: Array, columns: Array) -> Array:
    return np.asarray(rows // _BLOCK_PX * 100_000 + columns // _BLOCK_PX)


def _design(key: _Keyframe, middle: Vector3, radius: float) -> FloatArray:
    """(n, 3, 6): by how much normals change by ω in radians and τ in contact radii, about the middle."""
    eye = np.eye(3)
    points = key.points - middle
    turns = np.stack([np.cross(axis, points) for axis in eye], axis=-1)  # (n, 3, 3): d by ω
    moves = np.concatenate([turns, np.broadcast_to(radius * eye, turns.shape)], axis=-1)[:, :2]
    design = -np.einsum("nca,nak->nck", key.gradients, moves)
    design[..., :3] += np.stack([np.cross(axis, key.normals) for axis in eye], axis=-1)
    return np.asarray(design)


def _product(first: FloatArray, weight: FloatArray, second: FloatArray) -> FloatArray:
    """Σ w Jᵀ K of designs (n, 3, k), or of a design and residuals (n, 3)."""
    flat = (first * weight[:, None, None]).reshape(-1, first.shape[-1])
    return np.asarray(flat.T @ second.reshape(len(flat), -1))


def _shared(key: _Keyframe, view: _View, seen: FloatArray) -> float:
    """The share of the smaller contact that keyframe and frame both have."""
    return float((seen[:, 4] > 0.5).mean()) * key.size / min(key.size, view.size)


def _residual(key: _Keyframe, seen: FloatArray, now: RigidTransform) -> tuple[FloatArray, FloatArray]:
    """Normals now, turned back, less those of the keyframe, (n, 3), and their weights (n,).

    These are of Cauchy's likelihood over the variance, by the residuals themselves; 0 outside the contact.
    """
    residual, inside = seen[:, :3] @ now.rotation - key.normals, seen[:, 4] > 0.5
    length = np.linalg.norm(residual, axis=1)
    scale = max(float(np.median(length[inside])) if inside.any() else 0.0, _LEAST_NOISE)
    return residual, inside / scale**2 / (1.0 + (length / (_SOFT * scale)) ** 2)


def _depth_off(key: _Keyframe, seen: FloatArray, now: RigidTransform, weight: FloatArray) -> float:
    """By how many mm the surface now lies along the keyframe's normals, turned along, weighted mean."""
    off = seen[:, 3] - key.points @ now.rotation[2] - now.translation[2]
    return float(weight @ (off * (key.normals @ now.rotation[2])) / weight.sum())


def _depth_row(key: _Keyframe, middle: Vector3, radius: float) -> FloatArray:
    """(6,): by how many mm the surface moves along its normals, mean, by ω and τ as in `_design`."""
    torque = np.cross(key.points - middle, key.normals).mean(axis=0)
    return np.concatenate([torque, radius * key.normals.mean(axis=0)])


def _with_depth(normal: FloatArray, right: FloatArray, depth_row: FloatArray, off_mm: float) -> FloatArray:
    """The step (6,): five directions by the normals, the sixth by what is then left of the depth."""
    damped = normal[:5, :5] + 1e-6 * np.trace(normal[:5, :5]) * np.eye(5)
    step = np.append(np.linalg.solve(damped, right[:5]), 0.0)
    step[5] = (off_mm - depth_row @ step) / depth_row[5]
    return step


def _motion(step: FloatArray, middle: Vector3, radius: float) -> RigidTransform:
    """The motion (ω, τ in contact radii) about the middle."""
    turned = RigidTransform.from_rotation_vector(step[:3])
    shift = middle - turned.rotate(middle) + radius * step[3:]
    return RigidTransform(rotation=turned.rotation, translation=shift)


def _parameters(motion: RigidTransform, middle: Vector3, radius: float) -> FloatArray:
    """What `_motion` makes a motion of, (6,)."""
    return np.concatenate([motion.rotation_vector, (motion.apply(middle) - middle) / radius])
