"""The picture on which the contact circles of presses are looked at: a grid tells where, in pixels."""

from pathlib import Path

import numpy as np

from vntoolkit.arrays import LinearImage
from vntoolkit.pipeline.calibrate_presses import PressJob, PressReader
from vntoolkit.report import pictures
from vntoolkit.tactile.circles import find_contact_circle

_COLUMNS, _TILE_IN = 4, 2.6
_BRIGHTEST = 99.5  # percentile of a change that is drawn as the most


def write_press_overlay(path: Path | str, job: PressJob) -> None:
    """Draw the change of colour of every press, its circle, and a grid of u and v, rectified pixels."""
    from matplotlib.patches import Circle

    reader = PressReader(job)
    height, width = reader.background.shape
    count = len(reader.capture.present)
    rows = -(-count // _COLUMNS)
    with pictures.report_style(**{"axes.grid": True, "grid.alpha": 0.35, "axes.axisbelow": False}):
        figure = pictures.new_figure(_COLUMNS * _TILE_IN, rows * (_TILE_IN * height / width + 0.3))
        tiles = figure.subplots(rows, _COLUMNS, squeeze=False).ravel()
        for axes, frame in zip(tiles, reader.capture.frames(), strict=False):
            name = reader.names[frame.number]
            change, _ = reader.change(job.prepare(frame))
            circle = reader.labelled(name)
            by = "given"
            if circle is None and not reader.passes_over(name):
                circle, by = find_contact_circle(change), "found"
            axes.imshow(_shown(change))
            caption = "passed over"
            if circle is not None:
                caption = f"{by}: {circle.u_px:.0f} {circle.v_px:.0f} {circle.radius_px:.0f}"
                middle = (circle.u_px, circle.v_px)
                axes.add_patch(Circle(middle, circle.radius_px, fill=False, color="white", lw=1.2))
            axes.set_title(f"{name}  {caption}", fontsize=7)
            axes.tick_params(labelsize=6)
        for axes in tiles[count:]:
            axes.set_axis_off()
    pictures.write_figure(figure, path)


def _shown(change: LinearImage) -> pictures.Picture:
    """Grey where nothing changed."""
    most = max(float(np.percentile(np.abs(change), _BRIGHTEST)), 1e-6)
    return np.asarray(127.5 + 127.5 * np.clip(change / most, -1, 1) + 0.5).clip(0, 255).astype(np.uint8)
