"""The truth of a synthetic capture on disk: the parts that do not change, and each frame's."""

from __future__ import annotations

import json
import logging

import numpy as np

from vntoolkit.errors import BadRig
from vntoolkit.geometry.mesh import Mesh
from vntoolkit.io.atomic import write_text
from vntoolkit.io.exr import ExrCompression
from vntoolkit.io.images import write_png
from vntoolkit.io.label_images import write_labels, write_mask
from vntoolkit.io.maps import write_depth_map, write_flow, write_normal_map
from vntoolkit.io.rigs import write_rig
from vntoolkit.io.seams import write_seams
from vntoolkit.io.sequences import MeshSequenceWriter
from vntoolkit.photometry.rig import Rig
from vntoolkit.pipeline.simulation_job import SimulationFolder, SimulationJob
from vntoolkit.simulation.frame import SimulatedFrame
from vntoolkit.simulation.head.seams import seam_lines_px
from vntoolkit.simulation.image_formation import exposure_of_scene, light_colours_of, true_response
from vntoolkit.simulation.spectra import WAVELENGTHS_NM

logger = logging.getLogger(__name__)
_COMPRESSION = ExrCompression.ZIPS  # maps are mostly empty around the subject: a fifth of the size


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
        "frame_rate_hz": scene.frame_rate_hz,
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


def write_moving_mesh(job: SimulationJob, resume: bool) -> None:
    """Write the mesh of every frame, in order, a frame in memory at a time: vertices.npy and template.ply."""
    scene, numbers = job.built, job.numbers
    first = scene.vertices(numbers[0])
    template = Mesh(vertices=first, faces=scene.surface.faces)
    rate = scene.frame_rate_hz / numbers.step
    with MeshSequenceWriter(job.folder.truth, template, frame_rate_hz=rate, resume=resume) as writer:
        for place in range(writer.frame_count, len(numbers)):
            writer.append(first if place == 0 else scene.vertices(numbers[place]))


def write_frame(folder: SimulationFolder, place: int, frame: SimulatedFrame) -> None:
    """Write one frame's truth, and the frame itself, last, where the video is gathered from."""
    truth = frame.truth
    write_normal_map(folder.map_file("normals", place, ".exr"), truth.normals, compression=_COMPRESSION)
    write_depth_map(folder.map_file("depth", place, ".exr"), truth.depth, compression=_COMPRESSION)
    write_mask(folder.map_file("mask", place, ".png"), truth.normals.mask)
    write_labels(folder.map_file("visibility", place, ".png"), truth.labels)
    if truth.flow_px is not None:
        flow = np.where(truth.normals.mask[..., None], truth.flow_px, np.float32(np.nan))
        write_flow(folder.map_file("flow", place, ".exr"), flow, compression=_COMPRESSION)
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
