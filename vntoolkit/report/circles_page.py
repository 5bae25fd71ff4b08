"""The page on which contact circles of presses, and the corners of a gel, are corrected by hand."""

import json
from collections.abc import Mapping

import numpy as np

from vntoolkit.arrays import ByteArray, LinearImage
from vntoolkit.calibration.presses import Press
from vntoolkit.options.pages import ViewerOptions
from vntoolkit.photometry.transfer import Transfer, TransferCurve, encoded_from_linear
from vntoolkit.pipeline.press_circles import PressCircles
from vntoolkit.report.local_server import LocalServer
from vntoolkit.report.scene import Packet, page_from_template

_BRIGHTEST = 99.5  # percentile of a change that is drawn as the most


class CirclesViewer:
    """Serves the presses one by one; what is dragged there is written at once."""

    def __init__(self, circles: PressCircles, options: ViewerOptions | None = None) -> None:
        self._circles = circles
        title = "contact circles"
        self._server = LocalServer(
            options or ViewerOptions(),
            page_from_template(
                "circles.html.j2",
                script="circles.js",
                title=title,
                setup={"corners": circles.rectification is not None},
            ),
            {"/presses": self._presses, "/picture": self._picture},
            {"/circle": self._put, "/none": self._remove, "/corners": self._move_corners},
            script="circles.js",
        )
        self.address = self._server.address

    def close(self) -> None:
        """Stop serving."""
        self._server.close()

    def _presses(self, _query: Mapping[str, str]) -> bytes:
        shown = [
            {"name": press.name, "by": press.by, "circle": _numbers(press.circle)}
            for press in self._circles.presses
        ]
        view = self._circles.rectification
        corners = None if view is None else list(view.corners_px)
        return json.dumps({"presses": shown, "corners": corners}).encode()

    def _picture(self, query: Mapping[str, str]) -> bytes:
        kind = query["kind"]
        if kind == "gel":
            shown = _displayed(self._circles.untouched)
        elif kind == "change":
            shown = _difference(self._circles.change(int(query["press"])))
        else:
            shown = _displayed(self._circles.picture(int(query["press"])))
        block = np.full((*shown.shape[:2], 4), 255, np.uint8)
        block[..., :3] = shown
        packet = Packet()
        return packet.content({"picture": packet.raw_picture(block)})

    def _put(self, query: Mapping[str, str]) -> None:
        u, v, radius = (float(query[name]) for name in ("u", "v", "r"))
        self._circles.put(int(query["press"]), Press(u_px=u, v_px=v, radius_px=radius))

    def _remove(self, query: Mapping[str, str]) -> None:
        self._circles.put(int(query["press"]), None)

    def _move_corners(self, query: Mapping[str, str]) -> None:
        self._circles.move_corners(tuple(float(word) for word in query["at"].split(",")))


def _numbers(circle: Press | None) -> list[float] | None:
    return None if circle is None else [circle.u_px, circle.v_px, circle.radius_px]


def _displayed(rgb: LinearImage) -> ByteArray:
    brightest = max(float(np.percentile(rgb, _BRIGHTEST)), 1e-6)
    encoded = encoded_from_linear(np.clip(rgb / brightest, 0, 1), Transfer(curve=TransferCurve.SRGB))
    return np.asarray(255 * encoded + 0.5).astype(np.uint8)


def _difference(change: LinearImage) -> ByteArray:
    """Grey where nothing changed."""
    most = max(float(np.percentile(np.abs(change), _BRIGHTEST)), 1e-6)
    return np.asarray(127.5 + 127.5 * np.clip(change / most, -1, 1) + 0.5).clip(0, 255).astype(np.uint8)
