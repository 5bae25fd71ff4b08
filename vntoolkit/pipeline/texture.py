"""The texture of a registered surface: its colour without the lamps' shading, and relief finer than its mesh.

Both lie on the template's texture coordinates, its own picture: one texel a pixel. Every texel takes the
mean over the frames that see it, each weighed by how well it does. Noise grows with the slant. A texel is
looked up beside its place by the expected error of the track and by what moves while the shutter is open.
"""

import json
import logging
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy import ndimage

from vntoolkit.arrays import Faces, FloatArray, IntArray, Mask, Points, Points2
from vntoolkit.errors import VntError
from vntoolkit.geometry.camera import Camera
from vntoolkit.geometry.mesh import MeshSequence, face_normals, vertex_normals
from vntoolkit.geometry.rays import RayScene
from vntoolkit.io.atomic import require_writable_folder, write_text
from vntoolkit.io.footage.frame_range import sampled
from vntoolkit.io.footage.image_writing import write_png
from vntoolkit.io.maps_and_meshes.texture import SurfaceTexture
from vntoolkit.photometry.frame import count_lit
from vntoolkit.photometry.response import scaled_normals_from_rgb
from vntoolkit.photometry.transfer import Transfer, TransferCurve, encoded_from_linear
from vntoolkit.pipeline.opened_result import OpenedResult, read_result
from vntoolkit.pipeline.tracked_folder import read_tracks
from vntoolkit.shadows.albedo import fill_smoothly
from vntoolkit.tracking.slopes import sample_image

_LOGGER = logging.getLogger(__name__)
_FRAMES = 24  # evenly spread: more of them change a texel by less than a grey level
_LEAST_COSINE = 0.25  # of the slant: beyond 75° a pixel covers four texels
AGREES_PX = 4.0  # depth of the track and of the frame, over the size of a pixel: apart by more, it is hidden
_SAMPLED_PX = 0.5  # by which a texel is looked up beside its place even where all is known
_MIXED_PX = 2  # at the outline, where lens and shutter mix the subject with what is behind
_FEATHER = 9  # texels over which a frame's part fades in, so that no seam shows
_BRIGHTEST = 0.995  # quantile of the colours: if it is above full scale, all are lowered
_SRGB = Transfer(curve=TransferCurve.SRGB)


@dataclass(frozen=True, kw_only=True)
class TextureSummary:
    """texture: the files. covered: share of the surface's texels that a frame shows. frames: looked at."""

    texture: SurfaceTexture
    covered: float
    frames: int


def write_texture(
    folder: Path, track_folder: Path | None = None, *, footage: str = "", background: Path | None = None
) -> TextureSummary:
    """Write texture/albedo.png (8 bits, sRGB) and texture/normal.png into the track folder.

    Albedo: the frame's colour over its shading, so what the camera would see if each lamp met the surface
    square on. Normal: measured normals in the tangent space of the mesh, x along u, y along v, z outwards.
    What no frame shows is filled from around it. Without the footage only normal.png is written, which is
    said.
    """
    target = track_folder or folder / "track"
    result = read_result(folder, footage=footage, background=background, says_missing=False)
    tracks = read_tracks(target)
    sequence, numbers = tracks.sequence, tracks.numbers
    at = numbers.index(tracks.template)
    camera, shape = result.camera, (result.camera.height, result.camera.width)
    faces = sequence.template.faces
    places = camera.project(np.array(sequence.vertices[at]))
    texels = texels_of(places, faces, shape)
    colours = _Colours(result)
    with_maps = [row for row, n in enumerate(numbers) if result.folder.has(n, "normals", "depth")]
    rows = {*sampled(with_maps, _FRAMES), *({at} & set(with_maps))}
    colour, relief = _Mean(len(texels.faces), 3), _Mean(len(texels.faces), 3)
    for row in sorted(rows):
        number = numbers[row]
        pixels, weight, in_tangents = texels_in_frame(result, sequence, row, number, texels, places)
        relief.add(in_tangents, weight)
        albedo = colours.at(number, pixels)
        if albedo is not None:
            colour.add(albedo[:, :3], weight * albedo[:, 3])
    return _write(target, texels, colour, relief, len(rows))


@dataclass(frozen=True, kw_only=True, eq=False)
class Texels:
    """The texels that a surface covers. places: (t,) in the flattened picture. faces: (t,) the triangle under
    each. shares: (t, 3) of its corners. shape: of the picture.
    """

    places: IntArray
    faces: IntArray
    shares: FloatArray
    shape: tuple[int, int]

    def of_vertices(self, values: FloatArray, faces: Faces) -> FloatArray:
        """Return values of vertices (n, …) at the texels (t, …)."""
        corners = values[faces[self.faces]]
        return np.einsum("tk,tk...->t...", self.shares, corners)


def texels_of(pixels: Points2, faces: Faces, shape: tuple[int, int]) -> Texels:
    """Return the texels whose centres triangles cover. pixels: (n, 2), centres are integers."""
    v, u = np.divmod(np.arange(shape[0] * shape[1]), shape[1])
    centres = np.column_stack([u, v, np.ones(len(u))])
    flat = np.column_stack([pixels, np.ones(len(pixels))])
    along_axis = np.broadcast_to([0.0, 0.0, 1.0], centres.shape)
    hits = RayScene((flat, faces)).first_hits(np.hstack([centres * [1.0, 1.0, 0.0], along_axis]))
    corners = flat[faces[hits.faces]].transpose(0, 2, 1)
    shares = np.linalg.solve(corners, centres[hits.rays][..., None])[..., 0]
    return Texels(places=hits.rays, faces=hits.faces, shares=shares, shape=shape)


def texels_in_frame(
    result: OpenedResult, sequence: MeshSequence, row: int, number: int, texels: Texels, places: Points2
) -> tuple[Points2, FloatArray, Points]:
    """Find the texels in a frame with maps. places: (n, 2), of vertices in the texture.

    Return their pixels (t, 2), weights (t,), 0 where hidden, and unit normals in tangent space (t, 3).
    """
    normal_map, depth_map = result.normals(number), result.depth(number)
    assert depth_map is not None
    camera, faces = result.camera, sequence.template.faces
    vertices = np.array(sequence.vertices[row], dtype=np.float64)
    points = texels.of_vertices(vertices, faces)
    pixels = camera.project(points)
    along_u, along_v, outward = (
        unit_vectors(texels.of_vertices(axes, faces)) for axes in tangent_frames(vertices, faces, places)
    )
    towards = -unit_vectors(points) if camera.is_perspective else np.array([0.0, 0.0, -1.0])
    cosine = np.maximum(np.sum(outward * towards, axis=1), 0.0)
    pixel = (points[:, 2] if camera.is_perspective else 1.0) / camera.matrix[0, 0]
    gap = np.abs(sample_image(depth_map.depth[..., None], pixels)[:, 0] - points[:, 2])
    off = _off_px(sequence, row, texels, camera)
    subject = ndimage.binary_erosion(depth_map.mask & normal_map.mask, iterations=_MIXED_PX)
    is_seen = all_inside(subject, pixels) & (cosine > _LEAST_COSINE)
    is_seen &= np.isfinite(off) & (gap * cosine < AGREES_PX * pixel)
    measured = unit_vectors(sample_image(normal_map.normals_in_camera, pixels))
    in_tangents = np.stack([np.sum(a * measured, axis=1) for a in (along_u, along_v, outward)], axis=1)
    # A normal below the surface is another surface's. glTF has no such normal, and renderers show it black.
    is_seen &= in_tangents[:, 2] > 0
    faded = np.zeros(texels.shape, np.float32)
    faded.ravel()[texels.places] = is_seen
    faded = ndimage.uniform_filter(faded, _FEATHER).ravel()[texels.places]
    return pixels, np.where(is_seen, faded * (cosine / off) ** 2, 0.0), in_tangents


def _off_px(sequence: MeshSequence, row: int, texels: Texels, camera: Camera) -> FloatArray:
    """Return (t,) how far beside its place a texel is looked up, one standard deviation in pixels."""
    before, after = max(row - 1, 0), min(row + 1, len(sequence) - 1)
    first, last = (camera.project(np.array(sequence.vertices[at])) for at in (before, after))
    speed = np.linalg.norm(last - first, axis=1) / max(after - before, 1)
    uncertainty = sequence.uncertainty_px
    of_track = np.zeros(len(speed)) if uncertainty is None else np.array(uncertainty[row], dtype=np.float64)
    variance = speed**2 / 12 + of_track**2  # of a shutter that is open throughout, and of the track
    with np.errstate(invalid="ignore"):  # lost vertices have an infinite one
        return np.sqrt(texels.of_vertices(variance, sequence.template.faces) + _SAMPLED_PX**2)


def tangent_frames(vertices: Points, faces: Faces, places: Points2) -> tuple[Points, Points, Points]:
    """Return for each vertex the directions along u, along v and outwards, (n, 3) each, not of unit length.

    places: (n, 2) of the vertices in the texture, x right and y down. The one along u is square to the
    normal, and the one along v to both, as programs rebuild them from normals and texture coordinates.
    """
    edges = [vertices[faces[:, k]] - vertices[faces[:, 0]] for k in (1, 2)]
    (du, dv), (eu, ev) = ((places[faces[:, k]] - places[faces[:, 0]]).T for k in (1, 2))
    turned = np.sign(du * ev - eu * dv)
    along = (edges[0] * ev[:, None] - edges[1] * dv[:, None]) * turned[:, None]
    along *= np.linalg.norm(face_normals(vertices, faces), axis=1, keepdims=True)
    normals = vertex_normals(vertices, faces)
    u = np.zeros_like(normals)
    for corner in range(3):
        for axis in range(3):
            u[:, axis] += np.bincount(faces[:, corner], along[:, axis], minlength=len(vertices))
    u = unit_vectors(u - np.sum(u * normals, axis=1, keepdims=True) * normals)
    return u, np.cross(normals, u), normals


class _Colours:
    """Albedo of the frames, where the footage tells."""

    def __init__(self, result: OpenedResult) -> None:
        self._result = result
        self._reflectances = np.array([entry.reflectance for entry in result.manifest.known.materials])
        self.is_there = result.rig.gel is None and not result.lacks_background
        if result.rig.gel is None and result.lacks_background:
            _LOGGER.warning(
                "texture: no colours, for the reconstruction subtracted a background; give it as --background"
            )
        response = result.rig.response.central
        self._response = response
        strengths = np.linalg.norm(response.lights, axis=1)
        paints = self._reflectances if len(self._reflectances) else np.ones((1, 3))
        self._paints = (paints * strengths) @ np.linalg.inv(response.contributions_from_rgb).T

    def at(self, number: int, pixels: Points2) -> FloatArray | None:
        """Return (t, 4): linear colour, and 1 where all lamps arrive, unclipped; None without footage."""
        if not self.is_there:
            return None
        try:
            linear = self._result.linear(number)
        except VntError as error:
            _LOGGER.warning("texture: no colours: %s", error)
            self.is_there = False
            return None
        labels, lit = self._result.materials(number), self._result.labels(number)
        if labels is not None and len(self._reflectances):
            from vntoolkit.materials.relighting import relit

            linear = relit(linear, self._response, labels, self._reflectances)
        length = np.linalg.norm(scaled_normals_from_rgb(linear.rgb, self._result.rig.response), axis=2)
        is_good = np.isfinite(length) & ~linear.clipped
        if lit is not None:
            is_good &= count_lit(lit) == 3
        paints = self._paints[0 if labels is None or not len(self._reflectances) else labels]
        colour = np.where(is_good, length, 0.0)[..., None] * np.maximum(paints, 0.0)
        sampled = sample_image(np.concatenate([colour, is_good[..., None]], axis=2), pixels)
        sampled[:, 3] *= all_inside(is_good, pixels)
        return sampled


class _Mean:
    """Weighted mean of (t, c) values, one set after the other."""

    def __init__(self, count: int, channels: int) -> None:
        self._sum, self.weight = np.zeros((count, channels)), np.zeros(count)

    def add(self, values: FloatArray, weight: FloatArray) -> None:
        used = weight > 0
        self._sum[used] += weight[used, None] * values[used]
        self.weight += weight

    @property
    def mean(self) -> FloatArray:
        """(t, c); 0 where nothing was added."""
        return self._sum / np.where(self.weight > 0, self.weight, 1.0)[:, None]


def _write(target: Path, texels: Texels, colour: _Mean, relief: _Mean, frames: int) -> TextureSummary:
    folder = require_writable_folder(target / "texture")
    shown, albedo, scale = colour.weight > 0, None, 1.0
    if shown.any():
        values = colour.mean
        scale = min(1.0, 1.0 / float(np.quantile(values[shown].max(axis=1), _BRIGHTEST)))
        picture = filled(_spread(texels, np.clip(scale * values, 0, 1), shown))
        albedo = folder / "albedo.png"
        write_png(albedo, np.rint(255 * encoded_from_linear(picture, _SRGB)).astype(np.uint8))
    else:
        (folder / "albedo.png").unlink(missing_ok=True)
    flat = np.broadcast_to([0.0, 0.0, 1.0], (*texels.shape, 3)).copy()
    flat.reshape(-1, 3)[texels.places] = np.where(
        relief.weight[:, None] > 0, unit_vectors(relief.mean), [0, 0, 1.0]
    )
    write_png(folder / "normal.png", np.rint(127.5 + 127.5 * flat).astype(np.uint8), compression_level=9)
    covered = float((colour if albedo else relief).weight.astype(bool).mean()) if len(texels.faces) else 0.0
    facts = {"version": 1, "frames": frames, "covered": round(covered, 4), "colour_scale": round(scale, 6)}
    write_text(folder / "texture.json", json.dumps(facts, indent=2) + "\n")
    texture = SurfaceTexture(albedo=albedo, normal=folder / "normal.png")
    return TextureSummary(texture=texture, covered=covered, frames=frames)


def _spread(texels: Texels, values: FloatArray, shown: Mask) -> FloatArray:
    """Return the picture (h, w, c + 1) of values (t, c) at the texels; its last channel is 1 where shown."""
    picture = np.zeros((*texels.shape, values.shape[1] + 1))
    picture.reshape(-1, picture.shape[2])[texels.places[shown]] = np.column_stack(
        [values[shown], np.ones(int(shown.sum()))]
    )
    return picture


def filled(picture: FloatArray) -> FloatArray:
    """Return (h, w, c) of a picture (h, w, c + 1), smoothly continued where its last channel is 0."""
    values, known = picture[..., :-1], picture[..., -1]
    return np.where(known[..., None] > 0, values, fill_smoothly(values, known))


def all_inside(mask: Mask, pixels: Points2) -> Mask:
    """Return (t,): whether all four pixels around a place are in the mask."""
    height, width = mask.shape
    left, top = np.floor(pixels).astype(np.int64).T
    inside = (left >= 0) & (top >= 0) & (left < width - 1) & (top < height - 1)
    left, top = np.where(inside, left, 0), np.where(inside, top, 0)
    right, below = np.minimum(left + 1, width - 1), np.minimum(top + 1, height - 1)
    return inside & mask[top, left] & mask[top, right] & mask[below, left] & mask[below, right]


def unit_vectors(vectors: FloatArray) -> FloatArray:
    """Return vectors (..., 3) of length 1."""
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-300)
