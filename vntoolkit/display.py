"""How objects show themselves: one line in a terminal, a picture with a few figures in a notebook."""

import base64
import html
import io
from collections.abc import Mapping

import numpy as np

from vntoolkit.arrays import BoolArray, ByteArray, FloatArray

_LARGEST_PX = 360
_LIT_FROM = np.array([-0.4, -0.5, -0.77])  # of the picture of a surface: from the upper left
SCREEN_GAMMA = 2.2  # roughly the curve of a screen

Picture = ByteArray
Facts = Mapping[str, str]


class Displayed:
    """An object of the package: `repr` is one line, a notebook shows a picture beside a few figures.

    A dataclass among them needs `repr=False`, or it would print its arrays.
    """

    def _facts(self) -> Facts:
        """Return a few figures by name."""
        raise NotImplementedError

    def _picture(self) -> Picture | None:
        """Return what it looks like, (h, w, 3), or None."""
        return None

    def __repr__(self) -> str:
        facts = ", ".join(f"{name} {value}" for name, value in self._facts().items())
        return f"{type(self).__name__}({facts})"

    def _repr_html_(self) -> str:
        rows = "".join(
            f"<tr><td style='text-align:left'>{html.escape(name)}</td>"
            f"<td style='text-align:left'>{html.escape(value)}</td></tr>"
            for name, value in self._facts().items()
        )
        title, picture = type(self).__name__, self._picture()
        image = "" if picture is None else f"<img alt='{title}' src='{_data_url(picture)}'>"
        table = f"<table><caption><b>{title}</b></caption>{rows}</table>"
        return f"<div style='display:flex;gap:1em;align-items:center'>{image}{table}</div>"


def size_of(shape: tuple[int, ...]) -> str:
    """Return width and height of an image of that shape."""
    return f"{shape[1]}×{shape[0]}"


def share_of(mask: BoolArray) -> str:
    """Return how much of a mask is set."""
    return f"{mask.mean():.1%}" if mask.size else "none"


def picture_of_light(rgb: FloatArray) -> Picture:
    """Show linear colours (h, w, 3), full scale = 1."""
    return _bytes(np.clip(rgb, 0.0, 1.0) ** (1 / SCREEN_GAMMA))


def picture_of_normals(normals: FloatArray, mask: BoolArray) -> Picture:
    """Show normals in the camera frame (h, w, 3) in Blender's colours, white where `mask` is not set."""
    return _bytes(np.where(mask[..., None], 0.5 + 0.5 * normals * (1.0, -1.0, -1.0), 1.0))


def picture_of_depth(depth: FloatArray, mask: BoolArray) -> Picture:
    """Show depth (h, w), near bright and far dark, white where `mask` is not set."""
    if not mask.any():
        return np.full((*mask.shape, 3), 255, np.uint8)
    near, far = np.percentile(depth[mask], (1, 99))
    grey = 0.9 - 0.8 * np.clip((depth - near) / max(far - near, 1e-12), 0, 1)
    return _bytes(np.repeat(np.where(mask, grey, 1.0)[..., None], 3, axis=2))


def picture_of_points(points: FloatArray, normals: FloatArray | None) -> Picture:
    """Show points (n, 3) in the camera frame as seen from the camera, lit from the upper left."""
    canvas = np.full((_LARGEST_PX * 2 // 3, _LARGEST_PX * 2 // 3, 3), 255, np.uint8)
    if not len(points):
        return canvas
    low, high = points[:, :2].min(axis=0), points[:, :2].max(axis=0)
    # a cell a point on average at most, so that few points make a small picture and no sieve
    side = int(np.clip(0.7 * np.sqrt(len(points)), 8, len(canvas) - 1))
    scale = (side - 1) / max(float((high - low).max()), 1e-12)
    u, v = ((points[:, :2] - low) * scale).round().astype(int).T
    far_first = np.argsort(-points[:, 2], kind="stable")
    grey = np.full(len(points), 160.0)
    if normals is not None:
        grey = 40.0 + 200.0 * np.clip(normals @ (_LIT_FROM / np.linalg.norm(_LIT_FROM)), 0, 1)
    small = np.full((v.max() + 1, u.max() + 1, 3), 255, np.uint8)
    small[v[far_first], u[far_first]] = grey[far_first, None].astype(np.uint8)
    zoom = max(1, (len(canvas) - 1) // max(small.shape))
    return small.repeat(zoom, axis=0).repeat(zoom, axis=1)


def _bytes(values: FloatArray) -> Picture:
    step = max(1, -(-max(values.shape[:2]) // _LARGEST_PX))
    return (255 * np.clip(values[::step, ::step], 0, 1)).round().astype(np.uint8)


def _data_url(picture: Picture) -> str:
    from PIL import Image

    file = io.BytesIO()
    Image.fromarray(np.ascontiguousarray(picture)).save(file, format="png")
    return f"data:image/png;base64,{base64.b64encode(file.getvalue()).decode()}"
