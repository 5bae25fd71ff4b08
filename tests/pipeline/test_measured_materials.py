"""Footage of several paints: found once, carried through the frames, the same bytes whatever the workers."""

import logging
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from recipes.real_objects import read_capture
from tests.pipeline.test_reconstruct import digest
from vntoolkit.diagnosis.finding import FatalFinding, Finding, Level
from vntoolkit.diagnosis.inspection import Examination
from vntoolkit.errors import BadInput
from vntoolkit.geometry.camera import Camera
from vntoolkit.io.footage.captures import Capture
from vntoolkit.io.footage.decoding import EncodedFrame
from vntoolkit.io.footage.frame_range import FrameRange
from vntoolkit.io.footage.image_writing import write_png
from vntoolkit.io.maps_and_meshes.label_images import read_materials
from vntoolkit.io.maps_and_meshes.maps import read_normal_map
from vntoolkit.io.maps_and_meshes.masks import write_mask
from vntoolkit.io.maps_and_meshes.meshes import read_mesh
from vntoolkit.io.results.manifest import MaterialEntry, ReconstructionFolder, read_manifest
from vntoolkit.materials.search import Material, find_materials
from vntoolkit.options.normals import ShadowMethod
from vntoolkit.options.reconstruction import MaterialSearch, Product, ReconstructOptions
from vntoolkit.photometry.fit_quality import angles_deg
from vntoolkit.photometry.frame import LinearFrame
from vntoolkit.photometry.response import LightResponse
from vntoolkit.photometry.rig import Rig
from vntoolkit.pipeline import measured_materials
from vntoolkit.pipeline.frame_processor import FrameProcessor
from vntoolkit.pipeline.prepare import in_one_material
from vntoolkit.pipeline.reconstruct import reconstruct
from vntoolkit.pipeline.request import Request
from vntoolkit.pipeline.rig_material import MOST_UNEXPLAINED, share_of_wrong_lengths

DIRECTIONS = np.array([[0.5, 0.0, -0.866], [-0.25, 0.433, -0.866], [-0.25, -0.433, -0.866]])
COLOURS = np.array([[0.7, 0.1, 0.02], [0.08, 0.6, 0.1], [0.02, 0.12, 0.65]])
RESPONSE = LightResponse(matrix=COLOURS.T @ DIRECTIONS, light_colours=COLOURS)
SIZE, FRAMES = 96, 18
PAINTS = np.array([[0.9, 0.5, 0.3], [0.4, 0.8, 0.9]])


def dome() -> tuple[np.ndarray, np.ndarray]:
    v, u = (np.indices((SIZE, SIZE)) - (SIZE - 1) / 2) / (SIZE / 2)
    x, y = 0.75 * u, 0.75 * v
    return np.stack([x, y, -np.sqrt(np.maximum(1 - x * x - y * y, 0))], axis=-1), u * u + v * v < 1


def stripes(number: int) -> np.ndarray:
    """Stripes that move a pixel a frame."""
    return np.broadcast_to((np.arange(SIZE) + number) // 24 % 2, (SIZE, SIZE))


def filmed(folder: Path, paints: np.ndarray, frames: int, response: LightResponse = RESPONSE) -> Request:
    normals, mask = dome()
    v, u = np.indices(mask.shape)
    lamps = np.linalg.inv(COLOURS.T) @ response.at(np.stack([u, v], axis=-1))[0]
    shares = np.maximum((lamps @ normals[..., None])[..., 0], 0)
    for number in range(frames):
        light = shares * paints[stripes(number)] @ COLOURS * mask[..., None]
        noisy = 255 * light + np.random.default_rng(number).normal(0, 0.7, light.shape)
        write_png(folder / f"frame_{number:02d}.png", np.clip(np.round(noisy), 0, 255).astype(np.uint8))
    write_mask(folder / "mask.png", mask)
    return Request(
        source=str(folder / "frame_*.png"),
        rig=Rig(camera=Camera.orthographic(width=SIZE, height=SIZE), response=response),
        options=ReconstructOptions(to=Product.NORMALS, shadows=ShadowMethod.NONE),
        folder=ReconstructionFolder(root=folder / "out"),
        mask=folder / "mask.png",
    )


def into(job: Request, name: str, **options: object) -> Request:
    folder = ReconstructionFolder(root=job.folder.root.parent / name)
    return replace(job, folder=folder, options=replace(job.options, **options))


@pytest.fixture(scope="module")
def striped(tmp_path_factory: pytest.TempPathFactory) -> Request:
    job = filmed(tmp_path_factory.mktemp("striped"), PAINTS, FRAMES)
    reconstruct(job)
    return job


def test_moving_stripes_leave_no_seam(striped: Request) -> None:
    manifest = read_manifest(striped.folder.root)
    assert manifest.outputs == ["normals", "materials"]
    values = np.array([entry.reflectance for entry in manifest.known.materials])
    nearest = np.abs(np.log(values[:, None] / PAINTS)).max(axis=2)
    assert nearest.shape == (2, 2)
    assert nearest.min(axis=1).max() < 0.04
    normals, mask = dome()
    for number in (0, FRAMES - 1):
        found = read_normal_map(striped.folder.file("normals", number))
        labels = nearest.argmin(axis=1)[read_materials(striped.folder.file("materials", number))]
        assert np.mean(labels[mask] == stripes(number)[mask]) > 0.98
        assert angles_deg(found.normals_in_camera[mask], normals[mask]).mean() < 2.5


@pytest.mark.parametrize(("frames", "expected"), [(1, [0]), (2, [0, 1]), (4, [0, 1, 2]), (18, [0, 8, 16])])
def test_frames_far_apart_are_looked_at_and_decoded_once(striped, monkeypatch, frames, expected):
    footage = striped.open_footage()
    decoded, read = [], type(footage.capture).encoded

    def encoded(self: Capture, number: int) -> EncodedFrame:
        decoded.append(number)
        return read(self, number)

    monkeypatch.setattr(Capture, "encoded", encoded)
    seen = measured_materials.first_frames(striped.rig, striped.options, footage, range(frames))
    assert len(list(seen)) == len(expected)
    assert decoded == expected


def test_a_run_goes_on_with_the_materials_that_it_found(striped: Request) -> None:
    before = digest(striped.folder.root)
    striped.folder.file("materials", 3).unlink()
    assert reconstruct(striped).done == 1
    assert digest(striped.folder.root) == before


@pytest.mark.slow
def test_a_first_try_of_frames_changes_no_byte(striped: Request, caplog: pytest.LogCaptureFixture) -> None:
    """What is found once belongs to all frames that are asked for, in whatever order."""
    tried = into(striped, "tried")
    reconstruct(tried, frames=FrameRange(stop=2))
    few = read_manifest(tried.folder.root).known
    with caplog.at_level(logging.WARNING):
        summary = reconstruct(tried)
    assert (summary.resumed, summary.done) == (0, FRAMES)
    assert "with more frames than before (0:2:1), other lamps, materials or blur are found" in caplog.text
    assert "frames 0 to 1 from before are made again" in caplog.text
    manifest = read_manifest(tried.folder.root)
    assert manifest.known.materials != few.materials
    assert "frames 0 to 1 from before are made again" in manifest.findings[0].text
    assert digest(tried.folder.root) == digest(striped.folder.root)
    assert reconstruct(tried, frames=FrameRange(stop=2)).resumed == 2  # fewer frames are of the same request
    assert read_manifest(tried.folder.root).known == manifest.known


def test_footage_is_judged_without_the_pigment_of_its_materials(striped: Request) -> None:
    """Where it counted as shape, lengths of normals would be off as under a wrong M."""
    line, skin = np.array([0.22, 0.46, 0.86]), np.array([0.9, 0.65, 0.5])
    normals, mask = dome()
    v, u = np.indices(mask.shape)
    freckles = 0.5 * (np.sin(v / 3) * np.sin(u / 3) > 0.3)
    light = np.maximum(normals @ DIRECTIONS.T, 0) * skin * np.exp(-freckles[..., None] * line)
    frame = LinearFrame((light @ COLOURS * mask[..., None]).astype(np.float32))
    processor = FrameProcessor(striped.rig, striped.options, mask)
    off = []
    for pigment in (tuple(line / np.linalg.norm(line)), None):
        skins = [MaterialEntry(reflectance=tuple(skin), error_deg=0, residual=0, share=1, pigment=pigment)]
        judged = in_one_material(processor, striped.rig, skins)
        lengths = np.linalg.norm(judged(frame).rgb[mask] @ np.linalg.inv(RESPONSE.matrix).T, axis=1)
        off.append(np.abs(lengths - 1).mean())
    assert off[0] < 0.6 * off[1]


@pytest.mark.slow
def test_workers_do_not_change_a_byte(striped: Request) -> None:
    shared = into(striped, "shared")
    reconstruct(shared, jobs=2)
    assert digest(shared.folder.root) == digest(striped.folder.root)


@pytest.mark.parametrize(
    "name", ["yaleB01", *(pytest.param(n, marks=pytest.mark.slow) for n in ("buddha", "cat", "yaleB02"))]
)
def test_gloss_on_photographs_of_one_material_is_no_paint(tmp_path: Path, real_data: Path, name: str) -> None:
    """Gloss and light between folds bend lengths by a tenth and more, over whole cheeks alike."""
    capture = read_capture(real_data, name)
    lamps = np.diag(np.linalg.norm(capture.response.matrix, axis=1))
    height, width = capture.mask.shape
    write_png(tmp_path / "a.png", np.rint(65535 * capture.frame.rgb.clip(0, 1)).astype(np.uint16))
    write_mask(tmp_path / "mask.png", capture.mask)
    job = Request(
        source=str(tmp_path / "a.png"),
        rig=Rig(
            camera=Camera.orthographic(width=width, height=height),
            response=replace(capture.response, light_colours=lamps),
        ),
        options=ReconstructOptions(to=Product.NORMALS, shadows=ShadowMethod.NONE),
        folder=ReconstructionFolder(root=tmp_path / "out"),
        mask=tmp_path / "mask.png",
    )
    reconstruct(job)
    assert read_manifest(job.folder.root).known.materials == []


def test_the_rigs_own_material_gives_the_bytes_of_calibrated(tmp_path: Path) -> None:
    job = filmed(tmp_path, np.full((2, 3), 0.8), 1)
    reconstruct(job)
    calibrated = into(job, "calibrated", materials=MaterialSearch.CALIBRATED)
    reconstruct(calibrated)
    assert read_manifest(job.folder.root).known.materials == []
    assert digest(job.folder.root) == digest(calibrated.folder.root)


def test_what_is_fatal_stops_a_run_that_materials_might_explain(striped, monkeypatch):
    wrong = Finding(
        level=Level.FATAL, check="transfer", problem="the footage is encoded", measured="1", expected="0",
        remedy="say so",
    )  # fmt: skip

    def examined(*given: Any) -> Examination:
        return Examination(findings=[wrong] if given[4] is None else [])

    monkeypatch.setattr("vntoolkit.diagnosis.inspection.examine_capture", examined)
    job = into(striped, "stopped")
    with pytest.raises(FatalFinding, match="encoded"):
        reconstruct(job)
    assert not list(job.folder.root.glob("normals"))


def test_meshes_have_the_colour_of_their_material(striped: Request) -> None:
    job = into(filmed(striped.folder.root.parent, PAINTS, 1), "mesh", to=Product.MESH)
    reconstruct(replace(job, source=str(job.folder.root.parent / "frame_00.png")))
    colours = read_mesh(job.folder.file("mesh", 0)).colours
    assert colours is not None
    assert len(np.unique(np.round(colours, 2), axis=0)) == 2


def test_another_material_under_calibrated_is_told(striped, caplog):
    job = into(striped, "warned", materials=MaterialSearch.CALIBRATED)
    with caplog.at_level(logging.WARNING):
        reconstruct(job)
    assert "does not look like the calibration material" in caplog.text


@pytest.mark.parametrize(("share", "told"), [(0.6, "the rig's material is taken"), (0.3, "are wrong; film")])
def test_a_colour_that_was_not_found_is_told(tmp_path, caplog, monkeypatch, share, told):
    found = find_materials
    monkeypatch.setattr(
        f"{__name__}.stripes", lambda number: (np.indices((SIZE, SIZE))[1] < share * SIZE) * 1
    )
    monkeypatch.setattr(measured_materials, "find_materials", lambda *given: _only_bright(found(*given)))
    monkeypatch.setattr(measured_materials, "nats_over_grey", lambda *given: np.inf)
    job = filmed(tmp_path, PAINTS, 1)
    with caplog.at_level(logging.WARNING):
        reconstruct(job)
    assert "of the subject is not explained by the 1 found" in caplog.text
    assert told in caplog.text
    kept = [finding.text for finding in read_manifest(job.folder.root).known.findings]
    assert any("is not explained by the 1 found" in text and told in text for text in kept)
    assert len(read_manifest(job.folder.root).known.materials) == (share < 0.5)


def test_a_share_that_is_printed_as_the_limit_is_not_above_it() -> None:
    lengths = np.ones(1000)
    lengths[:104] = 2.0
    assert share_of_wrong_lengths(lengths) == MOST_UNEXPLAINED
    lengths[:106] = 2.0
    assert share_of_wrong_lengths(lengths) > MOST_UNEXPLAINED


def _only_bright(found: list[Material]) -> list[Material]:
    """Those that return much of the red lamp: the first paint."""
    return [material for material in found if material.reflectance.values[0] > 0.6]


def test_a_number_is_refused_where_the_lamps_colours_are_not_known(striped: Request) -> None:
    job = into(striped, "refused", materials=2)
    rig = replace(job.rig, response=LightResponse(matrix=RESPONSE.matrix))
    with pytest.raises(BadInput, match="does not hold the colours of its lamps"):
        reconstruct(replace(job, rig=rig))
    assert not job.folder.root.exists()


def test_dark_hair_belongs_to_the_subject_and_the_backdrops_noise_does_not() -> None:
    normals, mask = dome()
    hair = mask & (np.arange(SIZE)[:, None] < SIZE // 3)
    paints = np.where(hair, 0.06, 1.0) * mask
    light = np.maximum(normals @ DIRECTIONS.T, 0) @ COLOURS * paints[..., None]
    noise = np.random.default_rng(0).normal(0, 0.7 / 255, light.shape)
    camera = Camera.orthographic(width=SIZE, height=SIZE)
    options = ReconstructOptions(to=Product.NORMALS)
    processor = FrameProcessor(Rig(camera=camera, response=RESPONSE), options)
    subject = processor.lit_subject(LinearFrame((light + noise).astype(np.float32)))
    assert subject[hair].mean() > 0.95  # by the brightest channel 0.82
    assert subject[mask & ~hair].all()
    assert subject[~mask].mean() < 0.03
