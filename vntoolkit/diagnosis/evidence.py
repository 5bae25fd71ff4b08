"""What the checks look at: a few frames of a capture, averaged down, and the rig they are read with."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import cv2
import numpy as np

from vntoolkit.arrays import Array, BoolArray, ByteArray, Float32Array, FloatArray, Int64Array, Mask, Matrix3
from vntoolkit.photometry import transfer as transfers
from vntoolkit.photometry.frame import LinearFrame
from vntoolkit.photometry.rig import Rig

CHANNELS = ("red", "green", "blue")
FEW_PIXELS = 50_000  # of an averaged frame: enough for every statistic here, and a run starts within a second
# … but not where found materials meet. What lies near seams is left out, and of narrow patches nothing
# remained but some 60 pixels, in two places, which looked like turned lamps.
PIXELS_BETWEEN_SEAMS = 200_000
LIT = 0.3  # of the length that the brightest twentieth exceeds: what is darker is backdrop or in shadow
SUBJECT = 0.1  # of the brightest hundredth of the picture: dark paint is surface, too
NARROWEST_PX = 16  # of an averaged frame: a strip has no slopes to compare
FEWEST_PIXELS = 400  # that a statistic of a surface rests on
STEEPEST = 0.15  # least cosine between a normal that counts and the viewing ray
LARGEST_CHANGE = 0.02  # of the light; 2 % in one channel turn a normal by about half a degree
_CLOSING_PX = 5  # of a silhouette
_LEAST_SHARE = 0.06  # of the strongest lamp's light: the rest may be shadow
_LEAST_CHANNEL = 0.01  # of full scale; below it noise and the black level decide the colour
_BLOCKS = 6  # along each side: standard errors come from leaving out one of 36 blocks …
_LEAST_BLOCK_PX = 144  # … or of fewer: the surface of smaller ones is not independent of their neighbours'


@dataclass(frozen=True, kw_only=True, eq=False)
class Evidence:
    """A few frames of a capture, averaged down, and the rig that they are read with.

    rig: camera and response as calibrated. transfer: the curve that the footage was read with. light:
    (k, h, w, 3) linear, background removed. clipped: (k, h, w), True where any pixel under it is. inside:
    (k, h, w), True where the mask covers all of it; all True without a mask. masked: whether there is a mask.
    scale: averaged pixels per pixel of the footage, 0 to 1. numbers: of the k frames in the capture.
    painted: what this was levelled from, see `levelled`; None for footage as it is.
    """

    rig: Rig
    transfer: transfers.Transfer
    light: Float32Array
    clipped: BoolArray
    inside: BoolArray
    masked: bool
    scale: float
    numbers: tuple[int, ...]
    painted: "Evidence | None" = None

    @cached_property
    def directions(self) -> Float32Array:
        """(h, w, 3) viewing rays with z = 1; (0, 0, 1) everywhere for an orthographic camera."""
        ones = np.ones(self.light.shape[1:3])
        if not self.rig.camera.is_perspective:
            return np.multiply.outer(ones, [0.0, 0.0, 1.0]).astype(np.float32)
        return self.rig.camera.unproject(self.positions_px, ones).astype(np.float32)

    @cached_property
    def inverse(self) -> Float32Array:
        """M⁻¹, (3, 3), or (h, w, 3, 3) where it varies over the image."""
        return self.inverse_of(self.rig.response.matrix)

    def inverse_of(self, matrix: Matrix3) -> Float32Array:
        """Return the inverse of another central matrix, with the rig's variation on top."""
        response = self.rig.response
        if response.variation is None:
            return np.linalg.inv(matrix).astype(np.float32)
        matrices, _ = response.at(self.positions_px)
        return np.linalg.inv(matrices - response.matrix + matrix).astype(np.float32)

    @cached_property
    def positions_px(self) -> FloatArray:
        """(h, w, 2), where in the footage an averaged pixel lies."""
        v, u = np.indices(self.light.shape[1:3])
        return (np.stack([u, v], axis=-1) + 0.5) / self.scale - 0.5

    @cached_property
    def ambient(self) -> Float32Array:
        """(3,) or (h, w, 3) ambient light."""
        response = self.rig.response
        if response.variation is None:
            return response.ambient.astype(np.float32)
        return response.at(self.positions_px)[1].astype(np.float32)

    @cached_property
    def surface(self) -> BoolArray:
        """(k, h, w): lit, unclipped and inside the mask; the rig's normals play no part in it."""
        brightest = brightest_channel(self.light)
        chosen = self.inside & ~self.clipped & (darkest_channel(self.light) > _LEAST_CHANNEL)
        if not chosen.any():
            return chosen
        chosen &= brightest > LIT * np.percentile(brightest[chosen], 95)
        return np.asarray(chosen)

    @cached_property
    def lit(self) -> BoolArray:
        """(k, h, w): reached by all lamps, as far as their colours are known; else bright in all channels."""
        response = self.rig.response
        split = response.contributions_from_rgb.astype(np.float32)
        of_lamps = (self.light - self.ambient) @ split.T
        return np.asarray(darkest_channel(of_lamps) > _LEAST_SHARE * brightest_channel(of_lamps))

    @cached_property
    def levelled(self) -> "Evidence":
        """The same footage as if its subject were of one paint; the steps of paint are told without M."""
        from vntoolkit.materials.paint_levels import in_one_paint

        brightest = brightest_channel(self.light)
        subject = self.inside & ~self.clipped & (brightest > SUBJECT * np.percentile(brightest, 99))
        levelled = [
            in_one_paint(LinearFrame(rgb=light, clipped=clipped), there, self.rig.response)
            for light, clipped, there in zip(self.light, self.clipped, subject, strict=True)
        ]
        return replace(
            self,
            light=np.stack([np.asarray(frame.rgb) for frame in levelled]),
            clipped=np.stack([frame.clipped for frame in levelled]),
            painted=self,
        )

    @cached_property
    def read_otherwise(self) -> "Evidence":
        """The same footage read with a curve of the other kind."""
        other = of_the_other_kind(self.transfer)
        encoded = transfers.encoded_from_linear(np.maximum(self.light, 0.0), self.transfer)
        return replace(
            self, light=transfers.linear_from_encoded(encoded, other).astype(np.float32), transfer=other
        )

    @property
    def clipped_share(self) -> float:
        """Of the subject's pixels, the share that is clipped; 0 to 1."""
        clipped = int((self.clipped & self.inside).sum())
        return clipped / max(1, clipped + int(self.surface.sum()))

    @cached_property
    def blocks(self) -> Int64Array:
        """(h, w) number of the block that a pixel lies in; a block is the same place in every frame.

        Blocks hold as much surface as each other, so that a small subject has as many as a large one.
        """
        height, width = self.light.shape[1:3]
        seen: Mask = np.asarray(self.surface.any(axis=0))
        side = max(1, min(_BLOCKS, int(math.sqrt(seen.sum() / _LEAST_BLOCK_PX))))
        rows = _equal_parts(seen.sum(axis=1), side)
        blocks = np.empty((height, width), np.int64)
        for part in range(side):
            stripe = rows == part
            blocks[stripe] = part * side + _equal_parts(seen[stripe].sum(axis=0), side)
        return blocks


def of_the_other_kind(read: transfers.Transfer) -> transfers.Transfer:
    """Return an encoding curve for linear, else linear; the encoding ones differ too little to be told."""
    return transfers.Transfer.from_text("srgb" if read.curve is transfers.TransferCurve.LINEAR else "linear")


def _equal_parts(counts: Int64Array, parts: int) -> Int64Array:
    """Return (n,) the number of the part that each of n rows or columns is in; parts hold equal counts."""
    before = np.cumsum(counts) - counts / 2
    total = max(1, int(counts.sum()))
    return np.minimum((before * parts / total).astype(np.int64), parts - 1)


def evidence_from_frames(
    frames: Sequence[LinearFrame],
    rig: Rig,
    transfer: transfers.Transfer,
    mask: Mask | None = None,
    most_pixels: int = FEW_PIXELS,
) -> Evidence:
    """Average frames of the rig's size down. mask: (h, w) where the surface is, or None.

    Frames that are averaged down already are taken as they are. most_pixels: of an averaged frame.
    """
    small = [averaged_down(frame, most_pixels) for frame in frames]
    height, width = small[0].shape
    inside = np.ones((height, width), np.bool_)
    if mask is not None:
        inside = _resized(mask.astype(np.float32), (width, height)) > 0.999
    return Evidence(
        rig=rig,
        transfer=transfer,
        light=np.stack([np.asarray(frame.rgb) for frame in small]),
        clipped=np.stack([frame.clipped for frame in small]),
        inside=np.broadcast_to(inside, (len(small), *inside.shape)),
        masked=mask is not None,
        scale=width / rig.camera.width,
        numbers=tuple(frame.number for frame in frames),
    )


def averaged_down(frame: LinearFrame, most_pixels: int = FEW_PIXELS) -> LinearFrame:
    """Return a frame of at most so many pixels; clipped is where any pixel under it is."""
    height, width = frame.shape
    scale = math.sqrt(most_pixels / (height * width))
    size = (max(1, round(width * scale)), max(1, round(height * scale)))
    if size[0] >= width:
        return frame
    clipped = _resized(frame.clipped.astype(np.float32), size) > 0
    return LinearFrame(rgb=_resized(np.asarray(frame.rgb), size), clipped=clipped, number=frame.number)


# Over three channels numpy's own reductions take ten times as long.


def brightest_channel(light: Array) -> Array:
    """Return the largest of three channels, the last axis."""
    return np.maximum(np.maximum(light[..., 0], light[..., 1]), light[..., 2])


def darkest_channel(light: Array) -> Array:
    """Return the least of three channels, the last axis."""
    return np.minimum(np.minimum(light[..., 0], light[..., 1]), light[..., 2])


def lengths_of(vectors: Array) -> Array:
    """Return the lengths of vectors of two or three components, the last axis."""
    total = vectors[..., 0] ** 2 + vectors[..., 1] ** 2
    return np.asarray(np.sqrt(total + vectors[..., 2] ** 2 if vectors.shape[-1] == 3 else total))


def jackknife_error(left_out: FloatArray) -> FloatArray:
    """Return the standard errors (k,) of what was estimated without each of b parts, (b, k); 1 for none."""
    if not len(left_out):
        return np.ones(left_out.shape[1:])
    return np.asarray(np.sqrt((len(left_out) - 1) * left_out.var(axis=0)))


def silhouette(brightest: Array, inside: Mask | None) -> ByteArray:
    """Return (h, w), the subject by its brightness, inside a mask, without gaps and specks, as 0 and 1."""
    subject = (brightest > SUBJECT * np.percentile(brightest[::4, ::4], 99)).astype(np.uint8)
    if inside is not None:
        subject &= inside.astype(np.uint8)
    kernel = np.ones((_CLOSING_PX, _CLOSING_PX), np.uint8)
    for operation in (cv2.MORPH_CLOSE, cv2.MORPH_OPEN):
        subject = np.asarray(cv2.morphologyEx(subject, operation, kernel), np.uint8)
    return subject


def _resized(image: Float32Array, size: tuple[int, int]) -> Float32Array:
    if size == image.shape[1::-1]:
        return image
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.float32)


def scaled_normals(
    evidence: Evidence,
    light: Float32Array,
    mix: Matrix3 | None = None,
    inverse: Float32Array | None = None,
) -> Float32Array:
    """M⁻¹ (K r − a), (h, w, 3): the normals times albedo. mix: K, or None for r as it is."""
    inverse = evidence.inverse if inverse is None else inverse
    if mix is not None:
        light = light @ mix.T.astype(np.float32)
    lit = light - evidence.ambient
    if inverse.ndim == 2:
        return np.asarray(lit @ inverse.T)
    return np.asarray(np.einsum("vuij,vuj->vui", inverse, lit))
