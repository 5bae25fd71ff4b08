"""Gallery: the pictures of the guide, one for each thing that the tools make, from simulated captures.

    python recipes/gallery.py --out docs/img [--quick]        # 6 min of processor time, --quick 1 min

gel.jpg: touches of a tactile gel, their normals, and the depth in millimetres.
face.jpg: a face in make-up as captured, its normals, relief, and the mesh from the side.
compared.jpg: that face, and the errors of two methods: inversion of M alone, and `reconstruct`.
materials.jpg: a sweater with a printed logo, its materials, and normals without and with them.
tracked.jpg: a checkerboard printed on one frame of a dancer's sweater, and where it is in later frames.
dressed.jpg: that sweater on a walking figure; time runs to the right, a direction a row.
viewer.jpg, live.jpg: the pages of `view` and `live`, where Chromium and playwright are installed.
"""

import argparse
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

import vntoolkit as vt
from vntoolkit.evaluation.angular_error import angular_error_map
from vntoolkit.geometry.maps import DepthMap, NormalMap
from vntoolkit.io.atomic import write_bytes
from vntoolkit.io.footage.image_writing import encoded_image, resized_image
from vntoolkit.io.footage.video import write_video
from vntoolkit.io.maps_and_meshes.maps import read_normal_map
from vntoolkit.pipeline.checkerboard import write_checkerboard
from vntoolkit.pipeline.opened_result import OpenedResult
from vntoolkit.report.dents import picture_of_dents
from vntoolkit.report.mesh_views import View, picture_of
from vntoolkit.report.pictures import (
    ErrorScale,
    Picture,
    cropped,
    picture_of_depth,
    picture_of_errors,
    picture_of_normals,
    pictures_of_frame,
    tiled,
)

WIDTH_PX = 1400
TURNED_DEG = 35.0
WALK = Path(__file__).parents[1] / "data" / "walk.bvh"
DEEPEST_MM = 1.0  # of the scale
LIVE_HZ = 2.0  # slow enough for the page to open
BROWSER_FLAGS = ["--no-sandbox", "--disable-gpu", "--enable-unsafe-swiftshader"]


def write_picture(path: Path, rows: list[dict[str, Picture]], **more: Any) -> None:
    """Write rows of pictures under their headings as JPEG, and print the path."""
    write_bytes(path, encoded_image(resized_image(tiled(rows, **more), WIDTH_PX), ".jpg", quality=88))
    print(path, flush=True)


def filmed(scene: str, work: Path, frames: str, size: str) -> tuple[Path, OpenedResult]:
    """Film a scene, and reconstruct it with the rig of its own camera and lamps."""
    vt.simulate(scene, out=work / scene, frames=frames, size=size)
    rig = work / scene / "truth" / "rig.json"
    result = vt.reconstruct(work / scene / "capture.mkv", rig=rig, out=work / f"{scene}_result", distance=5.0)
    return work / f"{scene}_result", result


def gel(out: Path, work: Path) -> None:
    """Calibrate on twelve presses, and show three moments of a rolling touch."""
    small = {"size": "320x240", "samples": 1}
    for name, frames in (("rest", "0:1"), ("presses", "1:13"), ("touch", "38:60:8")):
        vt.simulate("gel", out=work / name, frames=frames, **small)
    untouched = work / "rest" / "capture.mkv"
    vt.calibrate_presses(
        work / "presses" / "capture.mkv", background=untouched, ball_radius_mm=2.4, pixel_mm=0.05,
        out=work / "gel.json",
    )  # fmt: skip
    device = vt.Gel.read(work / "gel.json", untouched)
    rows = []
    for frame in vt.open_capture(work / "touch" / "capture.mkv").encoded_frames():
        touch = device(frame.values)
        everywhere = NormalMap(normals_in_camera=touch.normals, mask=np.ones(touch.contact.shape, bool))
        depth = DepthMap(depth=0.001 * touch.depth_mm, mask=everywhere.mask)
        rows.append(
            {
                "captured": frame.values,
                "normals": picture_of_normals(everywhere),
                "depth below the gel at rest": picture_of_dents(depth, DEEPEST_MM),
            }
        )
    write_picture(out / "gel.jpg", rows)


def face(out: Path, work: Path, size: str) -> None:
    """Reconstruct one frame of a grimacing face."""
    _, result = filmed("face_makeup", work, "290:291", size)
    number = result.numbers[0]
    normal_map, depth_map = result.normals(number), result.depth(number)
    maps = [
        result.picture(number),
        picture_of_normals(normal_map),
        picture_of_depth(depth_map, result.camera),
    ]
    names = ("captured", "normals", "relief of the depth")
    row: dict[str, Picture] = dict(zip(names, cropped(maps, normal_map.mask, margin_px=8), strict=True))
    row["mesh, from the side"] = mesh_from_the_side(result, number, row["captured"])
    write_picture(out / "face.jpg", [row])
    compare(out, work / "face_makeup", result)


def compare(out: Path, film: Path, result: OpenedResult) -> None:
    """Show the errors of M⁻¹(r − a) and of a result beside the true normals of a simulated capture."""
    number, rig = result.numbers[0], vt.read_rig(film / "truth" / "rig.json")
    frame = vt.open_capture(film / "capture.mkv", vt.CaptureOptions(transfer=rig.transfer)).frame(0)
    truth = read_normal_map(next((film / "truth" / "normals").glob("*")))
    row = {"captured": result.picture(number), "true normals": picture_of_normals(truth, 255)}
    methods = {
        "errors of M⁻¹(r − a)": vt.normals_from_frame(frame, rig.response, truth.mask),
        "errors of reconstruct": result.normals(number),
    }
    for name, found in methods.items():
        errors, both = angular_error_map(found, truth)
        row[f"{name}: {errors[both].mean():.1f}°"] = picture_of_errors(errors, both, ErrorScale(most=40.0))
    pictures = cropped(list(row.values()), truth.mask, margin_px=8)
    write_picture(out / "compared.jpg", [dict(zip(row, pictures, strict=True))], scale=ErrorScale(most=40.0))


def mesh_from_the_side(result: OpenedResult, number: int, like: Picture) -> Picture:
    """Return a picture of a frame's mesh, as large as another picture."""
    mesh = replace(result.mesh(number), colours=None)
    height, width = like.shape[:2]
    return picture_of([mesh], View.around(mesh, width, height, azimuth_deg=TURNED_DEG, elevation_deg=8.0))


def materials(out: Path, work: Path, size: str) -> None:
    """Reconstruct a printed sweater with its materials, and as of one."""
    _, found = filmed("sweater_logo", work, "0:1", size)
    number, film = found.numbers[0], work / "sweater_logo"
    plain = vt.reconstruct(
        film / "capture.mkv", rig=film / "truth" / "rig.json", out=work / "one", to="normals",
        materials="calibrated", allow=("transfer", "white-balance"),
    )  # fmt: skip
    many, one = (pictures_of_frame(each, number, ground=255) for each in (found, plain))
    maps = [many["captured"], many.get("materials", many["captured"]), one["normals"], many["normals"]]
    names = ("captured", "materials found", "normals as of one material", "normals")
    row = dict(zip(names, cropped(maps, found.normals(number).mask, margin_px=8), strict=True))
    write_picture(out / "materials.jpg", [row])


def moving(out: Path, work: Path, size: str, frames: int) -> None:
    """Track a dancer's sweater, print a checkerboard on it, dress a walking figure, open the viewer."""
    folder, _ = filmed("sweater", work, f"0:{frames}", size)
    vt.track(folder)
    moments = write_checkerboard(folder, folder / "track")
    chosen = [moments[k] for k in sorted(moments)][:: max(1, len(moments) // 4)][:4]
    row: dict[str, Picture] = {f"moment {k}": picture for k, picture in enumerate(chosen, start=1)}
    write_picture(out / "tracked.jpg", [row])
    dressed = work / "dressed" / "sweater.usdc"
    vt.dress(folder / "track", motion=WALK, out=dressed, stop=1.2, preview=True)
    sheet = np.asarray(Image.open(next(dressed.parent.glob("*sheet*.png"))).convert("RGB"))
    write_picture(out / "dressed.jpg", [{"": sheet}])
    vt.view(folder, html=work / "scene.html")
    with page((work / "scene.html").as_uri()) as window:
        if window is not None:
            window.wait_for_timeout(4000)
            save_screenshot(window, out / "viewer.jpg")


def live(out: Path, work: Path) -> None:
    """Serve the touches of `gel`, each for a while, as a camera would, and look at the page."""
    film = work / "slowly.mkv"
    frames = vt.open_capture(work / "touch" / "capture.mkv").encoded_frames()
    write_video(film, (frame.values for frame in frames for _ in range(8)), LIVE_HZ)
    words = [
        sys.executable,
        "-m",
        "vntoolkit",
        "live",
        "--video",
        film,
        "--realtime",
        "--rig",
        work / "gel.json",
    ]
    words += ["--background", work / "rest" / "capture.mkv", "--seconds", "30"]
    with subprocess.Popen(list(map(str, words)), stdout=subprocess.PIPE, text=True, bufsize=1) as server:
        address = next((m[0] for line in server.stdout or () if (m := re.search(r"http://\S+", line))), "")
        with page(address) as window:
            if window is not None:
                window.wait_for_timeout(4000)
                save_screenshot(window, out / "live.jpg")
        server.terminate()


@contextmanager
def page(address: str) -> Iterator[Any]:
    """Open an address in Chromium; yields None, and says so, where that is not installed."""
    program = shutil.which("chromium") or shutil.which("chromium-browser")
    try:
        from playwright.sync_api import sync_playwright
    except ImportError:
        program = None
    if program is None or not address:
        print("no picture of a page: it needs chromium and playwright", flush=True)
        yield None
        return
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=program, args=BROWSER_FLAGS)
        window = browser.new_page(viewport={"width": 1200, "height": 760})
        window.goto(address)
        yield window
        browser.close()


def save_screenshot(window: Any, path: Path) -> None:
    """Write the window as JPEG, and print the path."""
    path.write_bytes(window.screenshot(type="jpeg", quality=85))
    print(path, flush=True)


def main(out: Path, size: tuple[int, int] = (640, 480), frames: int = 30) -> None:
    """Write the pictures into the folder `out`."""
    out.mkdir(parents=True, exist_ok=True)
    of_size = f"{size[0]}x{size[1]}"
    with tempfile.TemporaryDirectory() as name:
        work = Path(name)
        gel(out, work)
        live(out, work)
        face(out, work, of_size)
        materials(out, work, of_size)
        moving(out, work, of_size, frames)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("out/gallery"), help="folder to write")
    parser.add_argument("--quick", action="store_true", help="320x240, three frames")
    arguments = parser.parse_args()
    main(arguments.out, *(((320, 240), 3) if arguments.quick else ()))
