"""The viewer: a local page, served by viser, on which one scrubs through a reconstruction at full size."""

from __future__ import annotations

import threading
import time
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from vntoolkit.arrays import Points
from vntoolkit.errors import BadInput
from vntoolkit.geometry.mesh import Mesh
from vntoolkit.io.conventions import graphics_from_camera
from vntoolkit.io.maps_and_meshes.glb import glb_bytes
from vntoolkit.pipeline.opened_result import OpenedResult
from vntoolkit.report.pictures import Picture, pictures_of_frame
from vntoolkit.report.scene_page import Look, ResultSurfaces, Surface
from vntoolkit.report.serving import started_server, stop_server

_PLASTER = (190, 185, 177)
_CAPTIONS = {"depth": "depth, as relief", "shadows": "lights that arrive: white all, dark none"}
_WIRE = (130, 190, 255)
_LAMP = (-0.42, 0.26, 0.4)  # where the light starts, the subject's size being 1
_FASTEST_HZ = 15.0


@dataclass(frozen=True, kw_only=True)
class ViewerOptions:
    """Where the viewer is served.

    host: address to listen on; 127.0.0.1 is seen by this machine only, 0.0.0.0 by the whole network. port:
    port of the page; the next free one is taken where it is in use.
    """

    host: str = "127.0.0.1"
    port: int = 8080

    def __post_init__(self) -> None:
        if not 0 < self.port < 65536:
            raise BadInput(f"port: expected 1 to 65535, got {self.port}")


class ResultViewer:
    """Serves an opened result until `close`. Frames are read from disk as they are shown."""

    def __init__(self, result: OpenedResult, options: ViewerOptions | None = None) -> None:
        options = options or ViewerOptions()
        self._result = result
        self._surfaces = ResultSurfaces(result)
        self._lock = threading.Lock()
        self._playing = threading.Event()
        self._closed = threading.Event()
        self._pictured = result.numbers[0]  # the frame whose pictures are in the panel
        if not self._surfaces.kinds():
            raise BadInput(
                f"{result.folder.root}: holds no depth to show; run `vntoolkit reconstruct --to depth`, or "
                "look at the normals by `vntoolkit report`"
            )
        self._server = started_server(options.host, options.port)
        self._set_up_scene()
        self._set_up_controls()
        self.show(result.numbers[0])
        threading.Thread(target=self._play, daemon=True).start()

    @property
    def address(self) -> str:
        """The address to open in a browser."""
        return f"http://{self._server.get_host()}:{self._server.get_port()}"

    def show(self, number: int) -> None:
        """Show a frame."""
        with self._lock:
            if number != self._pictured:
                self._pictures_of(number)
            self._mesh_of(number)
            self._caption.content = (
                f"frame **{number}**, {self._slider.value + 1} of {len(self._result.numbers)}"
            )

    def close(self) -> None:
        """Stop serving."""
        self._closed.set()
        stop_server(self._server)

    def wait(self) -> None:
        """Serve until interrupted."""
        while not self._closed.wait(1.0):
            pass

    def _set_up_scene(self) -> None:
        """Bring the first frame to size 1 about the origin, y up; put the lamp before it."""
        meshes = [self._surfaces.mesh(self._result.numbers[0], kind) for kind in self._surfaces.kinds()]
        points = graphics_from_camera(np.concatenate([np.asarray(mesh.vertices) for mesh in meshes]))
        low, high = points.min(axis=0), points.max(axis=0)
        self._centre, self._size = (low + high) / 2, float((high - low).max())
        server: Any = self._server
        server.gui.configure_theme(
            show_logo=False,
            show_share_button=False,
            dark_mode=True,
        )
        server.gui.set_panel_label("vntoolkit")
        server.scene.set_up_direction("+y")
        server.initial_camera.position = (0.0, 0.0, 1.05)
        server.initial_camera.look_at = (0.0, 0.0, 0.0)
        server.scene.configure_default_lights(enabled=False)
        server.scene.configure_environment_map("warehouse", environment_intensity=0.15)
        server.scene.add_transform_controls(
            "/light", scale=0.14, position=_LAMP, disable_rotations=True, disable_sliders=True
        )
        server.scene.add_light_point("/light/lamp", intensity=1.7, decay=2.0)
        bulb = {"points": np.zeros((1, 3), np.float32), "colors": (255, 200, 80), "point_size": 0.024}
        server.scene.add_point_cloud("/light/bulb", point_shape="circle", **bulb)  # shines by itself

    def _set_up_controls(self) -> None:
        gui: Any = self._server.gui
        numbers = self._result.numbers
        self._caption = gui.add_markdown("")
        self._slider = gui.add_slider("time", 0, max(len(numbers) - 1, 1), 1, 0, disabled=len(numbers) == 1)
        self._button = gui.add_button("play", disabled=len(numbers) == 1)
        self._surface = gui.add_dropdown("surface", [kind.value for kind in self._surfaces.kinds()])
        first = self._pictures(numbers[0])
        looks = [look.value for look in Look if look is not Look.CAPTURED or "captured" in first]
        self._look = gui.add_dropdown("look", looks)
        self._wire = gui.add_checkbox("wireframe", initial_value=False)
        self._images = {
            name: gui.add_image(picture, label=_CAPTIONS.get(name, name)) for name, picture in first.items()
        }

        def refresh(_event: Any = None) -> None:
            self.show(numbers[min(self._slider.value, len(numbers) - 1)])

        for control in (self._slider, self._surface, self._look, self._wire):
            control.on_update(refresh)

        @self._button.on_click
        def _toggle(_event: Any) -> None:
            (self._playing.clear if self._playing.is_set() else self._playing.set)()
            self._button.label = "pause" if self._playing.is_set() else "play"

    def _play(self) -> None:
        """Advance the slider while playing; setting it shows the frame."""
        count = len(self._result.numbers)
        pause = 1.0 / min(self._result.manifest.input.frame_rate_hz, _FASTEST_HZ)
        while not self._closed.is_set():
            self._playing.wait(1.0)
            if self._playing.is_set():
                started = time.monotonic()
                self._slider.value = (self._slider.value + 1) % count
                self._closed.wait(max(0.02, pause - (time.monotonic() - started)))

    def _pictures(self, number: int) -> dict[str, Picture]:
        return pictures_of_frame(self._result, number, ground=20, beside_normals=40)

    def _pictures_of(self, number: int) -> None:
        for name, picture in self._pictures(number).items():
            if name in self._images:
                self._images[name].image = picture
        self._pictured = number

    def _mesh_of(self, number: int) -> None:
        surface, look = Surface(self._surface.value), Look(self._look.value)
        mesh = (self._surfaces.wires if self._wire.value else self._surfaces.mesh)(number, surface)
        vertices = self._placed(mesh.vertices)
        scene: Any = self._server.scene
        with self._server.atomic():
            if self._wire.value or look is Look.PLASTER:
                scene.remove_by_name("/painted")
                scene.add_mesh_simple(
                    "/surface", vertices, mesh.faces, color=_WIRE if self._wire.value else _PLASTER,
                    wireframe=self._wire.value,
                    side="double", cast_shadow=False, receive_shadow=False,
                )  # fmt: skip
                return
            scene.remove_by_name("/surface")
            colours = self._surfaces.colours(mesh, number, surface, look)
            painted = Mesh(vertices=vertices, faces=mesh.faces, colours=colours)
            # write the vertices as they are placed: glb_bytes turns from the camera frame
            turned = graphics_from_camera(vertices)
            shaded = look is Look.CHECKERBOARD  # captured colours have their light, normals want none
            data = glb_bytes(painted, iter([turned]), frame_rate_hz=30.0, shaded=shaded)
            scene.add_glb("/painted", data, cast_shadow=False, receive_shadow=False)

    def _placed(self, vertices: Points) -> npt.NDArray[np.float32]:
        turned = graphics_from_camera(np.asarray(vertices, dtype=np.float64))
        return ((turned - self._centre) / self._size).astype(np.float32)
