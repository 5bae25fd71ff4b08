"""DNG files of stated levels, margins and colour filters."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import tifffile

from tests.faults.stated_change import Change, H, Rng, W, chosen


def _dng(
    path: Path, rng: Rng, light: np.ndarray, *, white: int, stop: int | None = None, **tags: Any
) -> None:
    """Write a mosaic of (h, w, 3) light, noisy, that the sensor stops at `stop`.

    tags: black, (rows, columns) or four; down, across: added to it; active: its margins; pattern: of its
    filters; layout: of its rows.
    """
    black = np.array(tags.get("black", (64,) * 4))
    black = black.reshape(2, 2) if black.ndim == 1 else black
    pattern = tags.get("pattern", np.array([[0, 1], [1, 2]]))
    top, left, bottom, right = tags.get("active", (0, 0, *light.shape[:2]))
    v, u = np.mgrid[: light.shape[0], : light.shape[1]]
    v, u = v - top, u - left
    colour = pattern[v % len(pattern), u % pattern.shape[1]]
    down, across = tags.get("down", np.zeros(1, int)), tags.get("across", np.zeros(1, int))
    level = black[v % len(black), u % black.shape[1]] + down[v % len(down)] + across[u % len(across)]
    samples = level + np.take_along_axis(light, colour[..., None], 2)[..., 0] * (white - level)
    samples = np.rint(samples + rng.normal(0, 3, samples.shape)).clip(0, stop or white).astype(np.uint16)
    more = [
        (code, "2i", len(values), tuple(n for value in values.tolist() for n in (value, 1)), True)
        for code, values in ((50715, across), (50716, down)) if len(values) > 1
    ]  # fmt: skip
    write_dng(path, samples, 32803, [
        (33421, "H", 2, pattern.shape, True),
        (33422, "B", pattern.size, bytes(pattern.ravel().tolist()), True),
        (50711, "H", 1, tags.get("layout", 1), True),
        (50713, "H", 2, black.shape, True), (50714, "H", black.size, tuple(black.ravel().tolist()), True),
        *more, (50717, "I", 1, white, True), (50829, "I", 4, (top, left, bottom, right), True),
    ])  # fmt: skip


def write_dng(path: Path, samples: np.ndarray, photometric: int, tags: list[Any]) -> None:
    identity = [n for k in range(9) for n in (int(k % 4 == 0), 1)]
    extra = [
        (50706, "B", 4, bytes([1, 4, 0, 0]), True), (50708, "s", 0, "A Camera", True), *tags,
        (50721, "2i", 9, tuple(identity), True), (50728, "2I", 3, (1,) * 6, True), (50778, "H", 1, 21, True),
    ]  # fmt: skip
    tifffile.imwrite(path, samples, photometric=photometric, extratags=extra, metadata=None)


def dng_levels(folder: Path, rng: Rng) -> Change:
    """Black levels of each colour, and margins of any parity, of which LibRaw may leave out a pixel more."""
    light = rng.uniform(0.1, 0.7, 3)
    black = rng.integers(0, 900, 4) if rng.random() < 0.7 else np.full(4, 256)
    far = np.array([2 * H, 2 * W]) - rng.integers(0, 4, 2)
    margins = (*rng.integers(0, 4, 2).tolist(), *far.tolist())
    picture = np.tile(light, (2 * H, 2 * W, 1))
    _dng(
        folder / "a.dng",
        rng,
        picture,
        white=int(rng.integers(3000, 16384)),
        black=black,
        active=margins,
    )
    return Change(path=folder / "a.dng", rgb=light, tolerance=0.01)


def dng_cells(folder: Path, rng: Rng) -> Change:
    """Black levels that repeat over cells of any size, or differ between rows and columns."""
    light, size = rng.uniform(0.1, 0.7, 3), tuple(int(n) for n in rng.integers(1, 6, 2))
    margins = (*rng.integers(0, 4, 2).tolist(), 4 * H, 4 * W)
    height, width = 4 * H - margins[0], 4 * W - margins[1]
    added = [rng.integers(0, 200, n) * int(rng.integers(0, 2)) for n in (height, width)]
    _dng(
        folder / "a.dng", rng, np.tile(light, (4 * H, 4 * W, 1)), white=int(rng.integers(4000, 16384)),
        black=rng.integers(0, 900, size), active=margins, down=added[0], across=added[1],
    )  # fmt: skip
    return Change(path=folder / "a.dng", rgb=light, tolerance=0.01)


def dng_filters(folder: Path, rng: Rng) -> Change:
    """Filters of X-Trans are read; those of four equal neighbours, and staggered rows, are not."""
    light = rng.uniform(0.1, 0.7, 3)
    rows = ("GGRGGB", "GGBGGR", "BRGRBG", "GGBGGR", "GGRGGB", "RBGBRG")
    trans = np.array([["RGB".index(colour) for colour in row] for row in rows])
    bayer = np.array([[0, 1], [1, 2]])
    pattern, layout, refused = chosen(
        rng,
        (
            (np.roll(trans, rng.integers(0, 6, 2), (0, 1)), 1, ""),
            (np.kron(bayer, np.ones((2, 2), int)), 1, "filters repeat every 4×4 pixels"),
            (bayer, 2, "their rows are staggered"),
        ),
    )
    picture = np.tile(light, (4 * H, 4 * W, 1))
    _dng(folder / "a.dng", rng, picture, white=16000, pattern=pattern, layout=layout)
    # X-Trans has corners without a red or a blue pixel
    return Change(path=folder / "a.dng", rgb=light, refused=refused, tolerance=0.01, border_px=2)


def dng_colours(folder: Path, rng: Rng) -> Change:
    """Red, green and blue at each pixel, as phones and stitching programs write them."""
    light, white = rng.uniform(0.1, 0.7, 3), int(rng.integers(4000, 65536)) - rng.integers(0, 600, 3)
    black = rng.integers(0, 900, 3) if rng.random() < 0.5 else np.zeros(3, int)
    samples = np.tile(np.rint(black + light * (white - black)).astype(np.uint16), (2 * H, 2 * W, 1))
    levels = [(50714, "H", 3, tuple(black.tolist()), True), (50717, "I", 3, tuple(white.tolist()), True)]
    write_dng(folder / "a.dng", samples, 34892, levels)
    return Change(path=folder / "a.dng", rgb=light, tolerance=0.003)


def dng_white(folder: Path, rng: Rng) -> Change:
    """The sensor stops below the stated white; a third of the picture is overexposed."""
    white = int(rng.integers(4000, 16384))
    stop = int(white * rng.uniform(0.8, 1.0))
    light = np.tile(np.linspace(0.1, 0.7, 2 * W)[:, None], (2 * H, 1, 3))
    light[:, : 2 * W // 3] = 1.2
    _dng(folder / "a.dng", rng, light, white=white, stop=stop)
    return Change(path=folder / "a.dng", rgb=light.clip(0, 1), clipped=1 / 3, tolerance=1.0)
