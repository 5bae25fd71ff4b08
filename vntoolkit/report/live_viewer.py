"""The live page, served by viser: the camera's picture, normals, and the surface, turning in the light."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

from vntoolkit.errors import VntError
from vntoolkit.geometry.camera import Camera
from vntoolkit.geometry.maps import DepthMap, NormalMap
from vntoolkit.io.conventions import graphics_from_camera
from vntoolkit.io.live_sources import TimedFrame
from vntoolkit.meshing.surface import MeshOptions, mesh_from_depth
from vntoolkit.pipeline.live import LatencyMeter, LiveFigures
from vntoolkit.pipeline.live_frames import LiveResult, exposure_warnings
from vntoolkit.pipeline.live_recorder import LiveRecorder
from vntoolkit.report.live_status import LiveStatus
from vntoolkit.report.pictures import Picture, picture_of_normals
from vntoolkit.report.serving import started_server, stop_server
from vntoolkit.report.viewer import ViewerOptions

_PICTURE_PX = 480  # longer side of the pictures in the panel
_SURFACE_PX = 120  # vertices along the longer side
_PLASTER = (205, 200, 192)
_SWING_DEG, _SWING_S = 30.0, 6.0  # how far the surface turns to either side, and how long a swing takes
_CAPTION_HZ = 4.0
_WARNED_S = 1.5  # a warning stays for so long, so that it can be read
_CLIPPED = (255, 0, 255)
_CAMERA, _NORMALS = "camera (clipped pixels in magenta)", "normals"
_JPEG_QUALITY = 75


class LiveViewer:
    """Shows the newest result in a thread of its own; passes over results that come faster than it shows."""

    def __init__(
        self,
        camera: Camera,
        options: ViewerOptions | None = None,
        *,
        figures: Callable[[], LiveFigures],
        recorder: LiveRecorder | None = None,
    ) -> None:
        """figures: how it goes. recorder: what the page's button and its key r start and stop."""
        options = options or ViewerOptions()
        self.meter = LatencyMeter()
        self._camera, self._figures = camera, figures
        self._newest: tuple[LiveResult | None, TimedFrame] | None = None
        self._changed, self._closed = threading.Condition(), False
        self._placed: tuple[npt.NDArray[np.float64], float] | None = None
        self._captioned = 0.0
        self._recorder = recorder
        self._warned: dict[str, float] = {}
        self._problem = ""
        self._server = started_server(options.host, options.port)
        self._set_up()
        self._thread = threading.Thread(target=self._work, name="live-viewer", daemon=True)
        self._thread.start()

    @property
    def address(self) -> str:
        """The address to open in a browser."""
        return f"http://{self._server.get_host()}:{self._server.get_port()}"

    @property
    def watchers(self) -> int:
        """Number of browsers that look on."""
        return len(self._server.get_clients())

    def show(self, result: LiveResult, timed: TimedFrame) -> None:
        """Hand over a result; returns at once."""
        with self._changed:
            self._newest = result, timed
            self._warned |= dict.fromkeys(result.warnings, time.perf_counter())
            self._changed.notify()

    def show_failure(self, problem: VntError, timed: TimedFrame) -> None:
        """Say that a frame gave no normals, and what to change; returns at once."""
        told = exposure_warnings(timed.frame) or (f"no normals in this frame: {problem}",)
        with self._changed:
            self._newest = None, timed
            self._warned |= dict.fromkeys(told, time.perf_counter())
            self._changed.notify()

    def close(self) -> None:
        """Stop serving."""
        with self._changed:
            self._closed = True
            self._changed.notify()
        self._thread.join()
        stop_server(self._server)

    def _set_up(self) -> None:
        server: Any = self._server
        server.gui.configure_theme(
            show_logo=False,
            show_share_button=False,
            dark_mode=True,
            control_width="large",
        )
        server.gui.set_panel_label("vntoolkit live")
        server.scene.set_up_direction("+y")
        server.initial_camera.position = (0.0, 0.0, 1.25)
        server.initial_camera.look_at = (0.0, 0.0, 0.0)
        server.scene.configure_default_lights(enabled=False)
        server.scene.add_light_ambient("/ambient", intensity=0.4)
        server.scene.add_light_directional("/lamp", intensity=2.0, position=(-0.6, 0.6, 1.0))
        self._turning = server.scene.add_frame("/turning", show_axes=False)
        self._surface: Any = None
        self._status = server.gui.add_html('<p style="padding:0 .75rem">Waiting for the first frame …</p>')
        self._button: Any = None
        if self._recorder is not None:
            self._button = server.gui.add_button("record", hint="losslessly, what the camera gives; key r")
            self._button.on_click(self._toggle)
            server.gui.add_command("start or stop recording", hotkey="R").on_trigger(self._toggle)
        empty = np.zeros((9, 16, 3), np.uint8)
        self._images = {
            name: server.gui.add_image(empty, label=name, format="jpeg", jpeg_quality=_JPEG_QUALITY)
            for name in (_CAMERA, _NORMALS)
        }

    def _toggle(self, _event: Any) -> None:
        assert self._recorder is not None
        try:
            self._recorder.toggle()
            self._problem = ""
        except VntError as error:  # nothing can be written there: say so, go on showing
            self._problem = str(error)
        self._captioned = 0.0

    def _work(self) -> None:
        while True:
            with self._changed:
                while self._newest is None and not self._closed:
                    self._changed.wait()
                if self._closed or self._newest is None:
                    return
                (result, timed), self._newest = self._newest, None
            self._draw(result, timed)
            self.meter.reached(timed.arrived_s)

    def _draw(self, result: LiveResult | None, timed: TimedFrame) -> None:
        with self._server.atomic():
            self._images[_CAMERA].image = _picture_of_frame(timed)
            if result is not None:
                self._images[_NORMALS].image = picture_of_normals(_thinned(result), ground=40)
            if result is not None and result.depth_map is not None:
                self._draw_surface(result.depth_map)
            angle = np.deg2rad(_SWING_DEG) * np.sin(2 * np.pi * time.perf_counter() / _SWING_S)
            self._turning.wxyz = (np.cos(angle / 2), 0.0, np.sin(angle / 2), 0.0)
            now = time.perf_counter()
            if now - self._captioned > 1 / _CAPTION_HZ:
                self._captioned = now
                self._say(now)
        self._server.flush()

    def _draw_surface(self, depth_map: DepthMap) -> None:
        stride = max(1, round(max(depth_map.shape) / _SURFACE_PX))
        mesh = mesh_from_depth(depth_map, self._camera, options=MeshOptions(stride=stride))
        points = graphics_from_camera(np.asarray(mesh.vertices, dtype=np.float64))
        if self._placed is None:
            low, high = points.min(axis=0), points.max(axis=0)
            self._placed = (low + high) / 2, float((high - low).max()) or 1.0
        centre, size = self._placed
        vertices = ((points - centre) / size).astype(np.float32)
        faces = np.asarray(mesh.faces)
        same = self._surface is not None and np.array_equal(self._surface.faces, faces)
        if same:
            self._surface.vertices = vertices
            return
        self._surface = self._server.scene.add_mesh_simple(
            "/turning/surface", vertices, faces, color=_PLASTER, side="double",
            cast_shadow=False, receive_shadow=False,
        )  # fmt: skip

    def _say(self, now: float) -> None:
        """Bring rate, latency, warnings and recording up to date; a warning stays for a while."""
        rate, (median, _) = self.meter.figures()
        with self._changed:
            warnings = [text for text, seen in self._warned.items() if now - seen < _WARNED_S]
        recorder, recording = self._recorder, ""
        if recorder is not None:
            if recorder.is_recording:
                recording = recorder.files[-1].name if recorder.files else "…"
            if recorder.lost:
                warnings.append(f"the recording lost {recorder.lost} frames: the disk is too slow")
            warnings += [problem for problem in (recorder.problem, self._problem) if problem]
            self._button.label = "stop recording" if recorder.is_recording else "record"
        status = LiveStatus(
            figures=self._figures(), shown_hz=rate, shown_s=median, warnings=warnings, recording=recording
        )
        self._status.content = status.html()


def _thinned(result: LiveResult) -> NormalMap:
    """The normal map at the size of the panel."""
    step = max(1, round(max(result.normal_map.shape) / _PICTURE_PX))
    source = result.normal_map
    return NormalMap(
        normals_in_camera=source.normals_in_camera[::step, ::step], mask=source.mask[::step, ::step]
    )


def _picture_of_frame(timed: TimedFrame) -> Picture:
    """The camera's picture at the size of the panel, what is clipped painted over."""
    values = timed.frame.values
    step = max(1, round(max(values.shape[:2]) / _PICTURE_PX))
    small = values[::step, ::step]
    if small.dtype == np.uint8:
        shown = small.copy()
    elif small.dtype == np.uint16:
        shown = (small >> (timed.frame.bits - 8)).astype(np.uint8)
    else:
        shown = (255 * np.clip(small, 0, 1)).astype(np.uint8)
    shown[(shown == 255).any(axis=2)] = _CLIPPED
    return shown
