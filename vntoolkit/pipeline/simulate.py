"""Synthetic captures: render frames in one process or several, write ground truth, then the video.

Frames are independent of each other and of who renders them: the noise of a frame comes from a generator
of its own, its mesh from the file that the parent wrote. So neither jobs nor an interruption changes a byte.
"""

from __future__ import annotations

import json
import logging
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np

from vntoolkit import progress
from vntoolkit.arrays import Array, ByteArray, FloatArray, VisibilityLabels
from vntoolkit.errors import BadInput, BadMesh, BadMotion, BadRig
from vntoolkit.geometry.maps import NormalMap
from vntoolkit.geometry.mesh import Mesh
from vntoolkit.io.atomic import require_apart, write_text
from vntoolkit.io.files import source_file
from vntoolkit.io.footage.frame_range import FrameRange, sampled
from vntoolkit.io.footage.image_writing import resized_image, write_png
from vntoolkit.io.footage.images import read_image
from vntoolkit.io.footage.video import write_video
from vntoolkit.io.maps_and_meshes.arrays import map_npy
from vntoolkit.io.maps_and_meshes.exr import ExrCompression
from vntoolkit.io.maps_and_meshes.label_images import read_labels, write_labels
from vntoolkit.io.maps_and_meshes.maps import read_normal_map, write_depth_map, write_flow, write_normal_map
from vntoolkit.io.maps_and_meshes.masks import write_mask
from vntoolkit.io.results.folder import FolderKind, begin_run, option_values, write_lock
from vntoolkit.io.results.numbered_files import numbers_on_disk, remove_numbered
from vntoolkit.io.results.seams import write_seams
from vntoolkit.io.results.sequences import SEQUENCE_FILES, MeshSequenceWriter
from vntoolkit.io.rigs import write_rig
from vntoolkit.options.simulation import Nuisances, RenderOptions, SceneOptions
from vntoolkit.photometry.frame import lit_from_labels
from vntoolkit.photometry.rig import Rig
from vntoolkit.photometry.transfer import TransferCurve
from vntoolkit.pipeline.processes import map_in_processes
from vntoolkit.simulation.head.rig import seam_lines_px
from vntoolkit.simulation.image_formation import exposure_of_scene, light_colours_of, true_response
from vntoolkit.simulation.lights import FRAME_RATE_HZ, WAVELENGTHS_NM
from vntoolkit.simulation.render import Renderer, SimulatedFrame, frame_generator, require_same_topology
from vntoolkit.simulation.scene import Scene, build_scene

_SHEET_FRAMES, _SHEET_WIDTH = 8, 320
_VERSION = 2  # of the shapes and the renderer: frames of another version are not gone on with
_FIXED_TRUTH = ("rig.json", "lights.json", "scene.json", "seams.json", "poses.json")
_TRUE_MAPS = {"normals": ".exr", "depth": ".exr", "mask": ".png", "visibility": ".png"}  # of every frame
_MAP_SUFFIXES = _TRUE_MAPS | {"flow": ".exr"}  # where the next frame is known
_STAGED = ".frames"
SIMULATION = FolderKind(
    verb="simulate",
    holds="a capture",
    record="simulation.json",
    files=(
        "capture.mkv",
        "contact_sheet.png",
        *(f"truth/{name}" for name in (*_FIXED_TRUTH, *SEQUENCE_FILES)),
    ),
    frames={f"truth/{kind}": (suffix,) for kind, suffix in _MAP_SUFFIXES.items()} | {_STAGED: (".png",)},
    foreign=("capture.mkv",),
)
logger = logging.getLogger(__name__)
_COMPRESSION = ExrCompression.RLE  # maps are mostly empty; ZIP saves a fifth or more, in 1.6 times the time
Picture = ByteArray
_DISPLAY_GAMMA = 2.2


def simulate(job: SimulationJob, *, jobs: int = 1, overwrite: bool = False) -> int:
    """Film a scene into a folder: capture.mkv, truth/, contact_sheet.png, simulation.json.

    Return how many frames were rendered now: a run that was interrupted goes on where it stopped. jobs:
    worker processes. Raises `BadInput` where the folder holds another capture, `CannotWrite` while another
    run is at work there.
    """
    if jobs < 1:
        raise BadInput(f"jobs: expected at least 1 process, got {jobs}")
    folder, count = job.folder, len(job.numbers)
    require_apart([job.motion], [folder.truth])
    with write_lock(folder.root):
        resume = begin_run(folder.root, SIMULATION, job.description(), overwrite=overwrite)
        if resume and folder.video.exists():
            if folder.is_complete(count):
                return 0
            logger.warning("%s: true maps are gone, so all frames are rendered again", folder.truth)
        write_fixed_truth(job)
        missing = [place for place in range(count) if not folder.staged(place).exists()]
        progress.begin(f"simulate {job.scene}", count, count - len(missing))
        work = partial(_begin, job if jobs == 1 else replace(job))  # a copy: built scenes cannot be sent
        moments = write_moving_mesh(job, resume, missing)
        for _ in map_in_processes(work, moments, min(jobs, max(1, len(missing)))):
            progress.step()
        _write_contact_sheet(job)
        filmed = (read_image(folder.staged(place)) for place in range(count))
        write_video(folder.video, filmed, FRAME_RATE_HZ / job.numbers.step)
        remove_numbered(folder.staged(0).parent, ".png", range(count))
    return len(missing)


@dataclass(frozen=True, kw_only=True, eq=False)
class Moment:
    """A frame to render: its place in the video, its vertices (n, 3), and those of the next, if any."""

    place: int
    vertices: FloatArray
    following: FloatArray | None


def _begin(job: SimulationJob, threads: int | None) -> Callable[[Moment], Iterator[int]]:
    """Return what renders and writes a frame, and yields its place."""
    if threads is not None:
        job = replace(job, rendering=replace(job.rendering, threads=threads))
    renderer = Renderer(job.built, job.nuisances, job.rendering)

    def render(moment: Moment) -> Iterator[int]:
        number = job.numbers[moment.place]
        generator = frame_generator(job.options.seed, number)
        frame = renderer.render(moment.vertices, moment.following, generator, number)
        write_frame(job.folder, moment.place, frame)
        yield moment.place

    return render


def _write_contact_sheet(job: SimulationJob) -> None:
    linear = job.nuisances.file_transfer.curve is TransferCurve.LINEAR
    rows = []
    for place in sampled(range(len(job.numbers)), _SHEET_FRAMES):
        normals = read_normal_map(job.folder.map_file("normals", place))
        labels = read_labels(job.folder.map_file("visibility", place))
        film = read_image(job.folder.staged(place))
        rows.append(contact_row(film, normals, labels, linear, _SHEET_WIDTH))
    write_png(job.folder.root / "contact_sheet.png", contact_sheet(rows))


@dataclass(frozen=True, kw_only=True)
class SimulationFolder:
    """The layout of a synthetic capture on disk; frames are numbered by their place in the video."""

    root: Path

    @property
    def video(self) -> Path:
        """The capture itself."""
        return self.root / "capture.mkv"

    @property
    def truth(self) -> Path:
        """Everything that is known about it."""
        return self.root / "truth"

    def staged(self, place: int) -> Path:
        """A rendered frame that waits for the video to be written; comes last of a frame's files."""
        return self.root / _STAGED / f"{place:06d}.png"

    def map_file(self, kind: str, place: int) -> Path:
        """The file of one frame's normals, depth, mask, visibility or flow."""
        return self.truth / kind / f"{place:06d}{_MAP_SUFFIXES[kind]}"

    def is_complete(self, count: int) -> bool:
        """Whether the true maps of so many frames are there."""
        return all(
            set(numbers_on_disk(self.truth / kind, suffix)).issuperset(range(count))
            for kind, suffix in _TRUE_MAPS.items()
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class SimulationJob:
    """Everything that a worker needs, small enough to send to another process.

    scene: a name in `SCENES`. frames: which of the scene's frames are filmed. motion: .npy file, float
    (frames, n, 3) in the camera frame and metres, that moves the scene's mesh instead of its own motion.
    """

    scene: str
    folder: SimulationFolder
    options: SceneOptions = field(default_factory=SceneOptions)
    nuisances: Nuisances = field(default_factory=Nuisances)
    rendering: RenderOptions = field(default_factory=RenderOptions)
    frames: FrameRange = field(default_factory=FrameRange)
    motion: Path | None = None

    @cached_property
    def built(self) -> Scene:
        """The scene, moved by the motion file where there is one. Raises `BadMotion`, `BadMesh`."""
        scene = build_scene(self.scene, self.options)
        if self.motion is None:
            return scene
        moved = read_motion_file(self.motion)
        require_same_topology(moved[0], scene)
        return replace(
            scene,
            vertices=lambda frame: np.array(moved[frame], np.float64),
            frame_count=len(moved),
            camera_from_object=None,
        )

    @cached_property
    def numbers(self) -> range:
        """The scene's frames that are filmed."""
        return self.frames.numbers(self.built.frame_count)

    def description(self) -> dict[str, Any]:
        """Return what shapes the result, as JSON: two runs of the same description give the same bytes."""
        return {
            "version": _VERSION,
            "scene": self.scene,
            "frames": self.frames.to_text(),
            "motion": None if self.motion is None else asdict(source_file(self.motion)),
            "scene_options": {k: v for k, v in option_values(self.options).items() if v is not None},
            "nuisances": option_values(self.nuisances),
            "samples": self.rendering.samples,
        }


def read_motion_file(path: Path) -> FloatArray:
    """Map a (frames, n, 3) .npy file of vertices into memory. Raises `BadMotion`."""
    moved: FloatArray = map_npy(path, BadMotion)
    if moved.ndim != 3 or moved.shape[2] != 3 or not len(moved) or moved.dtype.kind != "f":
        raise BadMotion(
            f"{path}: expected floating point vertices (frames, n, 3), got {moved.shape} {moved.dtype}"
        )
    return moved


# Ground truth on disk: the parts that do not change, and those of each frame.


def write_fixed_truth(job: SimulationJob) -> None:
    """Write rig.json (where three lights give an M), lights.json, scene.json, poses.json and seams.json.

    seams.json holds the edges of lips and lids in the first frame, as `track --seams` reads them.
    """
    scene, truth = job.built, job.folder.truth
    try:
        response = true_response(scene, job.nuisances)
        rig = Rig(camera=scene.camera, response=response, transfer=job.nuisances.file_transfer)
        write_rig(truth / "rig.json", rig)
    except BadRig:
        logger.info("scene %s: a single light gives no M, so there is no rig.json", scene.name)
    write_text(truth / "lights.json", json.dumps(_lights(job), indent=1) + "\n")
    facts = {
        "scene": scene.name,
        "frame_rate_hz": FRAME_RATE_HZ,
        "scene_frames": list(job.numbers),
        "facts": dict(scene.facts),
    }
    write_text(truth / "scene.json", json.dumps(facts, indent=1) + "\n")
    seams = seam_lines_px(scene, job.numbers[0])
    if seams:
        write_seams(truth / "seams.json", seams)
    if scene.camera_from_object is not None:
        poses = [scene.camera_from_object(number).matrix.tolist() for number in job.numbers]
        write_text(truth / "poses.json", json.dumps({"camera_from_object": poses}, indent=1) + "\n")


def write_moving_mesh(job: SimulationJob, resume: bool, missing: Sequence[int]) -> Iterator[Moment]:
    """Write the mesh of every frame, in order: vertices.npy and template.ply.

    Yields the missing frames as soon as their vertices are there: one is rendered while the next is moved.
    """
    scene, numbers = job.built, job.numbers
    first = scene.vertices(numbers[0])
    template = Mesh(vertices=first, faces=scene.surface.faces)
    rate = FRAME_RATE_HZ / numbers.step
    with MeshSequenceWriter(job.folder.truth, template, frame_rate_hz=rate, resume=resume) as writer:

        def write_until(place: int) -> None:
            for k in range(writer.frame_count, min(place + 1, len(numbers))):
                writer.append(first if k == 0 else scene.vertices(numbers[k]))

        for place in missing:
            write_until(place + 1)
            # Mapped anew for every frame: a map kept open holds on to every page it ever showed.
            written = map_npy(job.folder.truth / "vertices.npy", BadMesh)[place : place + 2]
            vertices = np.array(written)
            following = vertices[1] if len(vertices) == 2 else None
            yield Moment(place=place, vertices=vertices[0], following=following)
        write_until(len(numbers))


def write_frame(folder: SimulationFolder, place: int, frame: SimulatedFrame) -> None:
    """Write one frame's truth, and the frame itself, last, where the video is gathered from."""
    truth = frame.truth
    write_normal_map(folder.map_file("normals", place), truth.normals, compression=_COMPRESSION)
    write_depth_map(folder.map_file("depth", place), truth.depth, compression=_COMPRESSION)
    write_mask(folder.map_file("mask", place), truth.normals.mask)
    write_labels(folder.map_file("visibility", place), truth.labels)
    if truth.flow_px is not None:
        flow = np.where(truth.normals.mask[..., None], truth.flow_px, np.float32(np.nan))
        write_flow(folder.map_file("flow", place), flow, compression=_COMPRESSION)
    write_png(folder.staged(place), frame.stored)


def _lights(job: SimulationJob) -> dict[str, object]:
    """Positions, and what the reference material makes of each light at the scene's centre."""
    scene = job.built
    exposure = exposure_of_scene(scene, job.nuisances)
    lights = [
        {
            "label_bit": bit,
            "position_m": position.tolist(),
            "direction": direction.tolist(),
            "colour": colour.tolist(),
            "spectrum": np.round(spectrum, 9).tolist(),
        }
        for bit, position, direction, colour, spectrum in zip(
            scene.lights.bits,
            scene.lights.positions,
            exposure.directions,
            light_colours_of(scene, exposure),
            scene.lights.spectra,
            strict=True,
        )
    ]
    ambient = scene.surface.reference_weights @ exposure.ambient_colours
    return {
        "frame": "camera: x right, y down, z forward; metres; colours in full scale = 1",
        "centre_m": np.asarray(scene.centre).tolist(),
        "ambient": ambient.tolist(),
        "wavelengths_nm": WAVELENGTHS_NM.tolist(),
        "lights": lights,
    }


def contact_row(
    stored: Array, normals: NormalMap, labels: VisibilityLabels, linear: bool, width: int
) -> Picture:
    """Return one frame's film, normals (colours as in a normal map file) and lit channels, side by side.

    stored: (h, w, 3) as in the file; linear: whether its values need a display curve. width: of each picture.
    """
    film = stored.astype(np.float32) / np.iinfo(stored.dtype).max
    if linear:
        film = film ** np.float32(1.0 / _DISPLAY_GAMMA)
    towards_viewer = normals.normals_in_camera * np.array([1.0, -1.0, -1.0], np.float32)
    coloured = np.where(normals.mask[..., None], 0.5 * (towards_viewer + 1.0), 0.0)
    lit = lit_from_labels(labels).astype(np.float32)
    pictures = [
        resized_image(np.rint(255.0 * np.clip(picture, 0.0, 1.0)).astype(np.uint8), width)
        for picture in (film, coloured, lit)
    ]
    return np.hstack(pictures)


def contact_sheet(rows: Iterable[Picture]) -> Picture:
    """Stack rows of equal size, two abreast where there are more than three."""
    stacked = list(rows)
    if len(stacked) <= 3:
        return np.vstack(stacked)
    if len(stacked) % 2:
        stacked.append(np.zeros_like(stacked[0]))
    return np.vstack([np.hstack(stacked[i : i + 2]) for i in range(0, len(stacked), 2)])
