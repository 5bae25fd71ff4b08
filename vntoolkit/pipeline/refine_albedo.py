"""Normals, depth and meshes again, with the reflectance that a tracked surface has over all its frames.

A vertex keeps its paint while it moves. Every frame tells paint from relief: its normals say how much of each
lamp's light arrives at a vertex, and what is returned beyond that is the reflectance. Frames are averaged;
those that were sure of the normal count most. Then the footage is reconstructed once more with the mean, into
TRACK/refined, a folder as any that `reconstruct` writes.
"""

import hashlib
import io
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from vntoolkit.arrays import Float32Array, FloatArray, IntArray, Mask, Matrix3, Points, Points2, Vectors
from vntoolkit.errors import BadInput
from vntoolkit.io.atomic import write_bytes
from vntoolkit.io.footage.frame_range import FrameRange
from vntoolkit.io.results.frame_log import FrameEntry
from vntoolkit.io.results.sequences import read_mesh_sequence
from vntoolkit.options.footage import Gaps
from vntoolkit.options.reconstruction import OnError, Product
from vntoolkit.photometry.frame import count_lit
from vntoolkit.photometry.levelling import leveller_of
from vntoolkit.pipeline.block_work import ReconstructionJob
from vntoolkit.pipeline.opened_result import OpenedResult, open_result
from vntoolkit.pipeline.options import options_from_values, sensor_from_values
from vntoolkit.pipeline.outputs import ReconstructionFolder
from vntoolkit.pipeline.painted_surface import TrackedReflectance
from vntoolkit.pipeline.reconstruct import ReconstructionSummary, reconstruct
from vntoolkit.pipeline.texture import Texels, all_inside, rows_with_maps, texels_in_frame, unit_vectors
from vntoolkit.pipeline.tracked_folder import REFINED_NAME, REFLECTANCE_NAME, read_track_record
from vntoolkit.tracking.slopes import sample_image

_FRAMES = 24  # evenly spread: twice as many turn normals by less than a tenth of a degree
_FEWEST_SEEN = 0.1  # of the vertices: with less the surface was not followed
_LEAST_SHARE = 0.06  # of the strongest lamp's light: the rest may be shadow
_LEAST_FACING = 0.1  # cosine to a lamp: less is nearly in shadow
_SURE_DEG = 2.0  # no normal is better than that
_OF_MEDIAN = 1.4826  # standard deviation over the median of absolute values


@dataclass(frozen=True, kw_only=True)
class RefinedAlbedo:
    """What was refined: reflectance, and the reconstruction with it."""

    reflectance: TrackedReflectance
    reconstruction: ReconstructionSummary


def refine_albedo(
    folder: Path,
    track_folder: Path | None = None,
    *,
    footage: str = "",
    background: Path | None = None,
    overwrite: bool = False,
    on_start: Callable[[int, int], None] = lambda total, done: None,
    on_frame: Callable[[FrameEntry], None] = lambda record: None,
) -> RefinedAlbedo:
    """Find the reflectance of every vertex of a tracked surface, and reconstruct its footage again with it.

    folder, track_folder: as `track` left them; None for folder/track. footage, background: as for
    `write_texture`. Writes reflectance.npy and refined/ into the track folder; goes on where an earlier run
    stopped. Raises `BadInput` where the rig does not hold the colours of its lamps, and where the background
    that the reconstruction subtracted is not given.
    """
    target = track_folder or folder / "track"
    result = require_refinable(folder, footage=footage, background=background)
    materials = result.manifest.materials
    unit = 1.0 if materials else float(result.manifest.options.get("inversion.relative_albedo", 1.0))
    logs = np.log([entry.reflectance for entry in materials] or [(unit, unit, unit)])
    looks, frames = _looks(result, target, logs)
    found = mean_surface_reflectance(looks, result.rig.response.central.lights)
    known = _written(found, looks, folder, target, unit, frames)
    outputs = result.manifest.outputs
    to = Product.MESH if "mesh" in outputs else Product.DEPTH if "depth" in outputs else Product.NORMALS
    options = options_from_values({**result.manifest.options, "to": to.value, "on_error": OnError.SKIP.value})
    keyed = "matte.key" in result.manifest.options
    job = ReconstructionJob(
        source=result.source,
        rig=result.rig,
        options=options,
        folder=ReconstructionFolder(root=target / REFINED_NAME),
        background=None if keyed else background,
        gaps=Gaps.SKIP,
        sensor=sensor_from_values(result.manifest.options),
        surface=known,
    )
    done = reconstruct(
        job,
        frames=FrameRange.from_text(result.manifest.frames),
        overwrite=overwrite,
        on_start=on_start,
        on_frame=on_frame,
    )
    return RefinedAlbedo(reflectance=known, reconstruction=done)


def require_refinable(folder: Path, *, footage: str = "", background: Path | None = None) -> OpenedResult:
    """Return the opened reconstruction; raise `BadInput` where its albedo cannot be refined."""
    result = open_result(folder, footage=footage, background=background)
    if result.rig.gel is not None:
        raise BadInput("--refine-albedo: a gel is of one reflectance; leave it out")
    if result.rig.response.light_colours is None:
        raise BadInput(
            "--refine-albedo: the rig does not hold the colours of its lamps, so that nothing tells colour "
            "from shape: calibrate with one photograph per lamp (--single-light), and reconstruct again"
        )
    if result.lacks_background:
        raise BadInput("--refine-albedo: the reconstruction subtracted a background; give it as --background")
    return result


def _looks(result: OpenedResult, target: Path, logs: Points) -> "tuple[SurfaceLooks, int]":
    """Return how the vertices looked, and in how many frames. logs: (m, 3), of the materials."""
    record, sequence = read_track_record(target), read_mesh_sequence(target)
    numbers = record["frames"][: len(sequence)]
    at, camera, faces = numbers.index(record["template"]), result.camera, sequence.template.faces
    shape = (camera.height, camera.width)
    places = camera.project(np.array(sequence.vertices[at]))
    vertices = _vertices_as_texels(places, faces, shape)
    contributions, seen, weights, normals, errors = [], [], [], [], []
    for row in rows_with_maps(result, numbers, _FRAMES):
        looked = texels_in_frame(result, sequence, row, numbers[row], vertices, places)
        lamps, is_lit = _lamps(result, numbers[row], looked.pixels)
        contributions.append(lamps)
        seen.append(is_lit & (looked.weight > 0))
        weights.append(looked.weight)
        found, error_deg = _normals(result, numbers[row], looked.pixels)
        normals.append(found)
        errors.append(error_deg)
    # What is seen steeply, or may be misplaced, tells of other paint: the better half of the looks count.
    weight, told = np.array(weights), np.array(seen)
    told &= weight >= (np.median(weight[told]) if told.any() else 0.0)
    labels = result.materials(numbers[at])
    materials = np.zeros(len(places), np.int64)
    if labels is not None and len(logs) > 1:
        materials = labels.ravel()[vertices.places].astype(np.int64)
    looks = SurfaceLooks(
        contributions=np.array(contributions, np.float32), seen=told,
        normals=np.array(normals, np.float32), error_deg=np.array(errors, np.float32), materials=materials,
        logs=logs[materials],
    )  # fmt: skip
    if not len(seen) or looks.seen.any(axis=0).mean() < _FEWEST_SEEN:
        raise BadInput(
            f"{target}: fewer than {_FEWEST_SEEN:.0%} of the vertices are seen where all lamps arrive; look "
            "at the track's expected error, and at shadows"
        )
    return looks, len(seen)


def _vertices_as_texels(places: Points2, faces: IntArray, shape: tuple[int, int]) -> Texels:
    """Return the vertices as texels, each the corner of one of its triangles."""
    face, shares = np.zeros(len(places), np.int64), np.zeros((len(places), 3))
    for corner in range(3):
        face[faces[:, corner]] = np.arange(len(faces))
    shares[faces[face] == np.arange(len(places))[:, None]] = 1.0
    u, v = np.clip(np.rint(places), 0, [shape[1] - 1, shape[0] - 1]).astype(np.int64).T
    return Texels(places=v * shape[1] + u, faces=face, shares=shares, shape=shape)


def _lamps(result: OpenedResult, number: int, pixels: Points2) -> tuple[Points, Mask]:
    """Return what every lamp contributes at places (n, 2), without ambient light, and where all arrive."""
    response, linear = result.rig.response, result.linear(number)
    if response.variation is not None:
        linear = leveller_of(response, linear.shape).frame(linear)
    central, lit = response.central, result.labels(number)
    is_sound = ~linear.clipped
    if lit is not None:
        is_sound &= count_lit(lit) == 3
    lamps = (sample_image(linear.rgb, pixels) - central.ambient) @ central.contributions_from_rgb.T
    arrive = lamps.min(axis=1) > np.maximum(_LEAST_SHARE * lamps.max(axis=1), 0.0)
    return lamps, arrive & all_inside(is_sound, pixels)


def _normals(result: OpenedResult, number: int, pixels: Points2) -> tuple[Points, FloatArray]:
    """Return the normals of a frame at places (n, 2), and their expected errors in degrees."""
    normal_map = result.normals(number)
    found = unit_vectors(sample_image(normal_map.normals_in_camera, pixels))
    if normal_map.error_deg is None:
        return found, np.ones(len(pixels))
    return found, sample_image(normal_map.error_deg[..., None], pixels)[:, 0]


def _written(
    found: "SurfaceReflectance", looks: "SurfaceLooks", folder: Path, target: Path, unit: float, frames: int
) -> TrackedReflectance:
    content = io.BytesIO()
    np.save(content, found.logs.astype(np.float32), allow_pickle=False)
    write_bytes(target / REFLECTANCE_NAME, content.getvalue())
    return TrackedReflectance(
        result=folder.absolute(),
        track=target.absolute(),
        unit=unit,
        sha256=hashlib.sha256(content.getvalue()).hexdigest(),
        frames=frames,
        seen=round(float(looks.seen.any(axis=0).mean()), 4),
        lines=tuple((_short(x), _short(y), _short(z)) for x, y, z in found.lines),
        spreads=tuple(map(_short, found.spreads)),
    )


def _short(value: float) -> float:
    return round(float(value), 4)


@dataclass(frozen=True, kw_only=True, eq=False)
class SurfaceLooks:
    """How a surface of n vertices looked in f frames.

    contributions: (f, n, 3) of the lamps, without ambient light. seen: (f, n), where these are sound and all
    lamps arrive. normals: (f, n, 3) that the frames were found to have, error_deg: (f, n), their expected
    errors. materials: (n,) number of each vertex's. logs: (n, 3), log ρ of its material.
    """

    contributions: Float32Array
    seen: Mask
    normals: Float32Array
    error_deg: Float32Array
    materials: IntArray
    logs: Points


@dataclass(frozen=True, kw_only=True, eq=False)
class SurfaceReflectance:
    """logs: (n, 3), log ρ of each vertex. lines: of each material, (m, 3), the line of log ρ along which
    paint varies, of length 1. spreads: (m,), robust standard deviation along it.
    """

    logs: Points
    lines: Points
    spreads: FloatArray


def mean_surface_reflectance(looks: SurfaceLooks, lights: Matrix3) -> SurfaceReflectance:
    """Return the reflectance of each vertex. lights: (3, 3), row k so that contribution k is row k · n.

    A vertex that no frame shows has that of its material.
    """
    paint, total = np.zeros(looks.logs.shape), np.zeros(len(looks.logs))
    frames = zip(looks.contributions, looks.seen, looks.normals, looks.error_deg, strict=True)
    for light, seen, normals, error_deg in frames:
        arrives = normals @ lights.T
        weight = (seen & (arrives.min(axis=1) > _LEAST_FACING)) / np.maximum(error_deg, _SURE_DEG) ** 2
        returned = np.log(np.maximum(light, 1e-6) / np.maximum(arrives, _LEAST_FACING)) - looks.logs
        paint += weight[:, None] * returned
        total += weight
    is_told = total > 0
    paint[is_told] /= total[is_told, None]
    count = int(looks.materials.max()) + 1
    lines, spreads = np.full((count, 3), 3.0**-0.5), np.zeros(count)
    for m in range(count):
        own = paint[is_told & (looks.materials == m)]
        if len(own):
            lines[m], spreads[m] = _line_of_paint(own)
    return SurfaceReflectance(logs=looks.logs + paint, lines=lines, spreads=spreads)


def _line_of_paint(paint: Points) -> tuple[Vectors, float]:
    """Return the main line (3,) of paint (n, 3), and its robust spread along it."""
    apart = paint - np.median(paint, axis=0)
    line = np.linalg.eigh(apart.T @ apart)[1][:, 2]
    line = line * np.sign(line.sum() or 1.0)
    return line, _OF_MEDIAN * float(np.median(np.abs(apart @ line)))
