"""Labels as indexed PNG: of visibility, in the colours of the lights that arrive, and of materials."""

import io
from pathlib import Path

import numpy as np

from vntoolkit.arrays import ByteArray, VisibilityLabels
from vntoolkit.checks import require_shape
from vntoolkit.errors import BadInput
from vntoolkit.io.atomic import write_bytes
from vntoolkit.photometry.frame import LABEL_LEGEND

# Colour of material k in materials/*.png: told apart easily, and no claim about the material's own colour.
MATERIAL_PALETTE = np.array(
    [
        [230, 225, 215], [200, 70, 60], [70, 120, 200], [240, 190, 60], [90, 160, 90], [150, 90, 170],
        [90, 190, 200], [240, 140, 80], [110, 85, 70], [230, 150, 190], [130, 140, 60], [60, 70, 90],
    ],
    dtype=np.uint8,
)  # fmt: skip

# Colour of label k: red, green, blue where light 0, 1, 2 arrives, white where all do, dark grey where none.
_PALETTE = np.array(
    [
        [40, 40, 40], [230, 60, 50], [60, 190, 80], [235, 210, 60],
        [60, 90, 220], [210, 80, 210], [70, 200, 220], [255, 255, 255],
    ],
    dtype=np.uint8,
)  # fmt: skip


def label_colours(labels: VisibilityLabels | np.uint8) -> ByteArray:
    """Return the legend's colour (..., 3) of each label, as `write_labels` shows it."""
    return _PALETTE[labels]


def write_materials(path: Path | str, labels: ByteArray) -> None:
    """Write (h, w) numbers of materials as indexed PNG, each in a colour of its own."""
    require_shape(labels, (None, None), "material labels")
    write_bytes(path, _indexed(labels, MATERIAL_PALETTE, "number of the material in reconstruction.json"))


def read_materials(path: Path | str) -> ByteArray:
    """Read (h, w) numbers of materials from an indexed PNG of `write_materials`."""
    return _numbers(path, MATERIAL_PALETTE, "material labels")


def write_labels(path: Path | str, labels: VisibilityLabels) -> None:
    """Write (h, w) labels 0 to 7 as indexed PNG; a viewer shows the colours of the lights that arrive."""
    require_shape(labels, (None, None), "visibility labels")
    if labels.dtype != np.uint8 or labels.max(initial=0) > 7:
        raise BadInput(f"{path}: visibility labels are bytes from 0 to 7")
    legend = "; ".join(f"{k}: {v}" for k, v in LABEL_LEGEND.items())
    write_bytes(path, _indexed(labels, _PALETTE, legend))


def read_labels(path: Path | str) -> VisibilityLabels:
    """Read (h, w) labels from an indexed PNG of `write_labels`, or from grey values 0 to 7."""
    return _numbers(path, _PALETTE, "visibility labels")


def _indexed(labels: ByteArray, palette: ByteArray, legend: str) -> bytes:
    from PIL import Image
    from PIL.PngImagePlugin import PngInfo

    image = Image.fromarray(labels)
    image.putpalette(palette.tobytes())
    text = PngInfo()
    text.add_text("Legend", legend)
    stream = io.BytesIO()
    image.save(stream, "PNG", bits=8, compress_level=1, pnginfo=text)
    return stream.getvalue()


def _numbers(path: Path | str, palette: ByteArray, what: str) -> ByteArray:
    from vntoolkit.io.footage.images import read_image

    rgb = read_image(path)
    if rgb.dtype != np.uint8:
        raise BadInput(f"{path}: {what} are 8-bit, got {rgb.dtype}")
    if rgb.max(initial=0) < len(palette):
        return rgb[..., 0].copy()
    is_label = [(rgb == colour).all(axis=2) for colour in palette]
    strange = ~np.logical_or.reduce(is_label)
    if strange.any():
        v, u = np.argwhere(strange)[0]
        raise BadInput(
            f"{path}: pixel ({u}, {v}) has the colour {rgb[v, u].tolist()}, no label of the legend"
        )
    return np.argmax(is_label, axis=0).astype(np.uint8)
