"""Masks as grey PNG, and the mattes of other programs."""

from pathlib import Path

import numpy as np

from vntoolkit.arrays import Array, Mask
from vntoolkit.checks import require_shape, require_some
from vntoolkit.errors import BadInput
from vntoolkit.io.footage.image_writing import write_png
from vntoolkit.io.footage.images import decode_image
from vntoolkit.io.footage.stated import full_scale


def write_mask(path: Path | str, mask: Mask) -> None:
    """Write an (h, w) mask as 8-bit grey PNG: 255 where True, 0 where False."""
    require_shape(mask, (None, None), "mask")
    write_png(path, mask.astype(np.uint8) * np.uint8(255))


def read_mask(
    path: Path | str,
    *,
    size: tuple[int, int] | None = None,
    max_megapixels: float | None = None,
    level: float = 0.5,
) -> Mask:
    """Read an (h, w) mask: True where a pixel is brighter than `level`, a share of full scale.

    size: (width, height) that it must have. Of integers that are 0 and one other, the other counts as True.
    """
    mask = read_matte(path, max_megapixels=max_megapixels, level=level)
    height, width = mask.shape
    if size is not None and (width, height) != size:
        raise BadInput(f"{path}: the mask is {width}×{height}, the capture {size[0]}×{size[1]}")
    require_some(mask, f"mask {path}")
    return mask


def read_matte(path: Path | str, *, max_megapixels: float | None = None, level: float = 0.5) -> Mask:
    """Read an (h, w) mask, which may hold no pixel, as `read_mask`.

    Colours count by their largest channel, so that any paint is seen. An alpha channel that is not opaque is
    the mask where the colours are all alike.
    """
    image = decode_image(path, max_megapixels=max_megapixels)
    mask = _above(image.colours.max(axis=2), level)
    alpha = image.alpha
    if alpha is None or (alpha == full_scale(alpha)).all():
        return mask
    outline = _above(alpha, level)
    if image.colours.min() != image.colours.max() and (outline != mask).any():
        raise BadInput(
            f"{path}: its colours and its alpha channel show different masks; save the one that is meant as "
            "grey, without alpha"
        )
    return outline


def _above(grey: Array, level: float) -> Mask:
    """Return where values exceed `level`; of integers that are 0 and one other, where they are not 0."""
    if grey.dtype == np.float32:
        return np.asarray(grey > level)
    is_label = bool(((grey == 0) | (grey == grey.max())).all())
    return np.asarray(grey > (0 if is_label and grey.min() == 0 else level * full_scale(grey)))
