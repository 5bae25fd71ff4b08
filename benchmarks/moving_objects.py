"""Real objects' depth and normals that turn, shift and bend under three lamps: how well they are tracked.

python -m benchmarks.moving_objects [--data FOLDER] [--objects bear cow] [--seeds 1] [--frames 61] [--out DIR]
                                                                                          # 5 min an object

Every object turns by up to 10 degrees, nods, rolls, shifts by some 20 pixels and bends by 3 to 6. Lamps lie
at random; shadows are cast; frames have 16 bits and noise of some 1/250 of full scale. Camera and lamps are
given. Every tenth frame a line says the error in pixels (median, 95th percentile) of all vertices in sight,
how many are reported visible, the 95th percentile of those, how many are off by more than 4 pixels, and the
shares of those that are reported lost.
"""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.ndimage import gaussian_filter
from scipy.spatial.transform import Rotation

import vntoolkit as vt
from benchmarks.painted_objects import parser_of_objects
from vntoolkit.arrays import Faces, FloatArray, Points, Vectors
from vntoolkit.evaluation.track_error import anchors_on_mesh, visible
from vntoolkit.geometry.camera import Camera
from vntoolkit.geometry.rays import RayScene, pixel_rays
from vntoolkit.io.footage.image_writing import write_png
from vntoolkit.io.rigs import write_rig
from vntoolkit.options.tracking import LOST_PX
from vntoolkit.pipeline.evaluate import read_object

OBJECTS = ("bear", "cow", "goblet", "pot2", "reading")
COLOURS = 0.8 * np.array([[0.9, 0.1, 0.05], [0.15, 0.8, 0.1], [0.05, 0.12, 0.85]])
PERIOD = 60.0  # frames of one turn to and fro
STEP_PX = 12.0  # a triangle that is deeper joins what does not hang together
BLUR_PX, NOISE = 0.6, 0.004
OFF_PX = 4.0


@dataclass(frozen=True, kw_only=True, eq=False)
class MovingObject:
    """A scanned surface and how it moves: vertices, unit normals (n, 3) in the camera frame, faces (m, 3).

    pixel: the length that a pixel covers. phases, bend, wave: drawn at random. lamps: (3, 3) unit directions.
    """

    camera: Camera
    vertices: Points
    normals: Vectors
    faces: Faces
    pixel: float
    phases: FloatArray
    bend: FloatArray
    wave: FloatArray
    lamps: Vectors

    @classmethod
    def read(cls, folder: Path, seed: int) -> MovingObject:
        """Read the object of a folder; the seed draws motion and lamps."""
        camera, normal_map, depth = read_object(folder)
        seen = normal_map.mask & np.isfinite(depth)
        v, u = np.nonzero(seen)
        vertices = camera.unproject(np.column_stack([u, v]).astype(np.float64), depth[seen])
        pixel = float(np.median(depth[seen]) / camera.matrix[0, 0])
        number = np.full(seen.shape, -1)
        number[seen] = np.arange(len(vertices))
        a, b, c, d = number[:-1, :-1], number[:-1, 1:], number[1:, :-1], number[1:, 1:]
        whole = np.minimum(np.minimum(a, b), np.minimum(c, d)) >= 0
        faces = np.concatenate([np.stack(each, axis=-1)[whole] for each in ((a, c, b), (b, c, d))])
        faces = faces[np.ptp(vertices[faces][..., 2], axis=1) < STEP_PX * pixel]
        rng = np.random.default_rng(seed)
        size = np.ptp(vertices, axis=0)[:2].max()
        bend, wave = rng.normal(size=(2, 3))
        tilt, turn = np.radians(rng.uniform(25.0, 45.0)), rng.uniform(0.0, 2.0 * np.pi)
        around = turn + np.arange(3) * 2.0 * np.pi / 3.0
        return cls(
            camera=camera, vertices=vertices, faces=faces, pixel=pixel,
            normals=normal_map.normals_in_camera[seen].astype(np.float64),
            phases=rng.uniform(0.0, 2.0 * np.pi, 6),
            bend=bend / np.linalg.norm(bend) * rng.uniform(3.0, 6.0) * pixel,
            wave=wave / np.linalg.norm(wave) * 4.0 * np.pi / size,
            lamps=np.column_stack(
                [np.sin(tilt) * np.cos(around), np.sin(tilt) * np.sin(around), np.full(3, -np.cos(tilt))]
            ),
        )  # fmt: skip

    def at(self, frame: int) -> tuple[Points, Vectors]:
        """Return vertices and normals (n, 3) of a frame."""
        pace = 2.0 * np.pi * frame / PERIOD * np.array([1.0, 1.3, 0.7, 0.9, 0.6, 1.1])
        yaw, pitch, roll, right, down, bent = np.sin(pace + self.phases) - np.sin(self.phases)
        size = np.ptp(self.vertices, axis=0)[:2].max()
        centre = np.array([*self.vertices.mean(axis=0)[:2], np.median(self.vertices[:, 2]) + 0.3 * size])
        phase = (self.vertices - centre) @ self.wave
        moved = self.vertices - centre + bent * np.sin(phase)[:, None] * self.bend
        # The deformation is I + b wᵀ; normals turn by the transpose of its inverse (Sherman and Morrison).
        slope = bent * np.cos(phase)
        turned = (slope * (self.normals @ self.bend)) / (1.0 + slope * (self.wave @ self.bend))
        normals = self.normals - turned[:, None] * self.wave
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        rotation = Rotation.from_euler("yxz", [10.0 * yaw, 5.0 * pitch, 4.0 * roll], degrees=True).as_matrix()
        shift = centre + np.array([12.0 * right, 8.0 * down, 0.0]) * self.pixel
        return moved @ rotation.T + shift, normals @ rotation.T

    def photograph(self, frame: int, rng: np.random.Generator) -> FloatArray:
        """Return the linear image (h, w, 3) of a frame."""
        vertices, normals = self.at(frame)
        shape = self.camera.height, self.camera.width
        # A hair beside the pixels' centres: there a ray may slip between the triangles of the first frame.
        columns, rows = np.meshgrid(np.arange(shape[1]) + 0.0137, np.arange(shape[0]) + 0.0091)
        origins, directions = pixel_rays(self.camera, np.column_stack([columns.ravel(), rows.ravel()]))
        scene = RayScene((vertices, self.faces))
        hits = scene.first_hits(np.hstack([origins, directions]))
        weights = np.column_stack([1.0 - hits.barycentric.sum(axis=1), hits.barycentric])
        seen = np.einsum("pc,pck->pk", weights, normals[self.faces[hits.faces]])
        seen /= np.linalg.norm(seen, axis=1, keepdims=True)
        points = directions[hits.rays] * hits.distances[:, None]
        light = np.zeros((len(points), 3))
        for lamp, colour in zip(self.lamps, COLOURS, strict=True):
            before = points + (2.5 * lamp - [0.0, 0.0, 1.0]) * self.pixel
            lit = ~scene.blocked(before, directions=np.broadcast_to(lamp, before.shape).copy())
            light += (np.maximum(seen @ lamp, 0.0) * lit)[:, None] * colour
        image = np.zeros((*shape, 3))
        image.reshape(-1, 3)[hits.rays] = light
        image = gaussian_filter(image, (BLUR_PX, BLUR_PX, 0.0))
        return (image + rng.normal(0.0, NOISE, image.shape) * np.sqrt(0.3 + image)).clip(0.0, 1.0)


def tracked(name: str, folder: Path, seed: int, frames: int, out: Path) -> None:
    """Film, reconstruct and track one object, and print its errors."""
    moving = MovingObject.read(folder, seed)
    (out / "frames").mkdir(parents=True)
    rng = np.random.default_rng(seed + 1000)
    for number in range(frames):
        levels = np.round(moving.photograph(number, rng) * 65535.0).astype(np.uint16)
        write_png(out / f"frames/{number:06d}.png", levels)
    response = vt.LightResponse(matrix=COLOURS.T @ moving.lamps, light_colours=COLOURS)
    write_rig(out / "rig.json", vt.Rig(camera=moving.camera, response=response))
    vt.reconstruct(out / "frames", rig=out / "rig.json", out=out / "result", to="depth")
    result = vt.track(out / "result")
    assert result.uncertainty_px is not None
    anchors = anchors_on_mesh(
        moving.camera.project(result.vertices[0]), moving.at(0)[0], moving.faces, moving.camera
    )
    for number in range(10, frames, 10):
        vertices, _ = moving.at(number)
        points = anchors.points(vertices)
        judged = anchors.found & visible(points, vertices, moving.faces, moving.camera)
        where = moving.camera.project(points[judged])
        error = np.linalg.norm(moving.camera.project(result.vertices[number][judged]) - where, axis=1)
        kept, off = result.uncertainty_px[number][judged] <= LOST_PX, error > OFF_PX
        reported = (off & ~kept).sum() / max(off.sum(), 1)
        print(
            f"{name} {seed}, frame {number}: {np.median(error):.2f} / {np.percentile(error, 95):.1f} px, "
            f"visible {kept.mean():.0%}: / {np.percentile(error[kept], 95):.1f} px, "
            f"off {off.mean():.1%}, of that reported lost {reported:.0%}",
            flush=True,
        )


def main() -> None:
    parser = parser_of_objects(__doc__)
    parser.add_argument("--objects", nargs="+", default=OBJECTS)
    parser.add_argument("--seeds", type=int, nargs="+", default=[1])
    parser.add_argument("--frames", type=int, default=61)
    parser.add_argument("--out", type=Path, help="keep captures and results in this folder")
    arguments = parser.parse_args()
    if arguments.data is None:
        raise SystemExit("give --data FOLDER: the folder with bear, cow, goblet, pot2, reading")
    with tempfile.TemporaryDirectory() as temporary:
        for seed in arguments.seeds:
            for name in arguments.objects:
                out = (arguments.out or Path(temporary)) / f"{name}{seed}"
                tracked(name, arguments.data / name, seed, arguments.frames, out)


if __name__ == "__main__":
    main()
