"""`track --refine-albedo`: a bare face and a plain one, from footage to refined normals; what it refuses."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import vntoolkit as vt
from tests.dome_result import DomeResult, dome_result
from vntoolkit.errors import BadInput
from vntoolkit.evaluation.angular_error import angular_error_map
from vntoolkit.io.maps_and_meshes.label_images import read_labels
from vntoolkit.io.maps_and_meshes.maps import read_normal_map
from vntoolkit.io.results.manifest import read_manifest
from vntoolkit.options.reconstruction import ReconstructOptions
from vntoolkit.options.tracking import TrackingOptions
from vntoolkit.photometry.frame import ALL_LIT
from vntoolkit.pipeline.opened_result import open_result
from vntoolkit.pipeline.options import option_values, options_from_values
from vntoolkit.pipeline.painted_surface import PaintedSurface, TrackedReflectance
from vntoolkit.pipeline.refine_albedo import refine_albedo
from vntoolkit.pipeline.track import TrackJob, track

__all__ = ["dome_result"]


@pytest.fixture(scope="module")
def bare_face(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A bare face, four frames of 320 by 240 pixels, with the true lamps and camera; tracked."""
    root = tmp_path_factory.mktemp("face")
    vt.simulate("face", out=root / "film", frames="0:16:4", size="320x240")
    refined_face(root, "out")
    return root


def refined_face(root: Path, name: str) -> Path:
    """Reconstruct the film of `root`, track it, and refine it; return the reconstruction's folder."""
    film = root / "film"
    rig = film / "truth/rig.json"
    vt.reconstruct(film / "capture.mkv", rig=rig, out=root / name, to="depth", allow=("transfer",))
    track(TrackJob(folder=root / name, options=TrackingOptions()))
    refine_albedo(root / name)
    return root / name


def mean_error_deg(folder: Path, film: Path) -> float:
    """Mean error of the normals where all lamps arrive, over the frames."""
    errors = []
    for path in sorted((folder / "normals").glob("*.exr")):
        error, both = angular_error_map(
            read_normal_map(path), read_normal_map(film / "truth/normals" / path.name)
        )
        lit = read_labels(film / f"truth/visibility/{path.stem}.png") == ALL_LIT
        errors.append(error[both & lit])
    return float(np.concatenate(errors).mean())


@pytest.mark.slow
def test_normals_of_a_bare_face_are_no_worse_after_it(bare_face: Path) -> None:
    film, out = bare_face / "film", bare_face / "out"
    before, after = mean_error_deg(out, film), mean_error_deg(out / "track/refined", film)
    assert after < before + 0.1  # every frame's own surface has told its paint


@pytest.mark.slow
def test_paint_that_was_averaged_is_in_doubt_as_in_one_frame(bare_face: Path) -> None:
    film, out = bare_face / "film", bare_face / "out"
    within = []
    for folder in (out, out / "track/refined"):
        for path in sorted((folder / "normals").glob("*.exr")):
            found = read_normal_map(path)
            error, both = angular_error_map(found, read_normal_map(film / "truth/normals" / path.name))
            assert found.error_deg is not None
            within.append(np.mean(error[both] <= found.error_deg[both]))
    before, after = np.split(np.array(within), 2)
    assert after.mean() > before.mean() - 0.05


@pytest.mark.slow
def test_the_folder_is_as_any_other_and_says_what_it_is(bare_face: Path) -> None:
    out, refined = bare_face / "out", bare_face / "out/track/refined"
    of, own = read_manifest(out), read_manifest(refined)
    assert (of.materials, of.frames, of.outputs) == (own.materials, own.frames, own.outputs)
    assert of.surface is None
    assert own.surface is not None
    assert own.surface.frames == 4
    assert 0.5 < own.surface.seen <= 1.0
    assert all(len(list((refined / name).iterdir())) == 4 for name in own.outputs)


@pytest.mark.slow
def test_a_run_that_was_stopped_goes_on_with_the_same_bytes(bare_face: Path) -> None:
    refined = bare_face / "out/track/refined"
    files = sorted(path for path in refined.rglob("*.exr"))
    whole = [path.read_bytes() for path in files]
    for path in files[1::2]:
        path.unlink()
    refine_albedo(bare_face / "out")
    assert [path.read_bytes() for path in files] == whole


@pytest.mark.slow
def test_a_subject_of_one_colour_stays_as_it_was(bare_face: Path) -> None:
    result = open_result(bare_face / "out")
    count = max(len(result.manifest.materials), 1)
    known = TrackedReflectance(
        result=bare_face / "out", track=bare_face / "out/track", unit=1.0, sha256="", frames=4, seen=1.0,
        lines=((0.5, 0.5, 0.7),) * count, spreads=(0.01,) * count,
    )  # fmt: skip
    frame = result.linear(0)
    relit = PaintedSurface(known, result.rig.response).relit(frame, frame, 0, result.materials(0))
    np.testing.assert_array_equal(relit.rgb, frame.rgb)
    assert "normals are as before" in known.described()
    assert replace(known, spreads=(0.2, 0.01)).described() == "paint varies by 20% in 1 of 2 materials"


@pytest.mark.slow
def test_tracking_again_removes_what_belonged_to_the_old_tracks(bare_face: Path, tmp_path: Path) -> None:
    assert (bare_face / "out/track/reflectance.npy").exists()
    track(TrackJob(folder=bare_face / "out", options=TrackingOptions(), template=2), overwrite=True)
    assert not (bare_face / "out/track/reflectance.npy").exists()


def test_a_rig_without_the_colours_of_its_lamps_is_refused_before_tracking(
    dome_result: DomeResult, tmp_path: Path
) -> None:
    with pytest.raises(BadInput, match="does not hold the colours of its lamps"):
        refine_albedo(dome_result.folder)
    with pytest.raises(BadInput, match="does not hold the colours of its lamps"):
        vt.track(dome_result.folder, out=tmp_path / "track", refine_albedo=True)
    assert not (tmp_path / "track").exists()


def test_options_are_read_back_from_a_manifest() -> None:
    options = ReconstructOptions(materials=3, smoothing=0.01)
    assert options_from_values(option_values(options)) == options
    assert options_from_values({}) == ReconstructOptions()
