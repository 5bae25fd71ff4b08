"""Trackers side by side: error against frame, one curve each, and the checkerboards that they carry."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from vntoolkit.evaluation.track_error import TrackError
from vntoolkit.report.pictures import Picture, cropped
from vntoolkit.report.style import new_figure, report_style, write_figure
from vntoolkit.report.tiles import write_tiles

_LOWEST_PX = 0.05
_MOMENTS, _MOMENT_PX = 3, 220


def write_error_plot(path: Path, errors: Mapping[str, Sequence[TrackError]], title: str = "") -> None:
    """Write a PNG or SVG (by the suffix) of median and 95 % error in pixels by frame, on log scales."""
    with report_style():
        figure = new_figure(9.6, 3.6)
        axes = figure.subplots(1, 2, sharex=True, sharey=True)
        for name, series in errors.items():
            frames = [error.frame for error in series]
            columns = ([error.median_px for error in series], [error.p95_px for error in series])
            for one, values in zip(axes, columns, strict=True):
                one.plot(frames, [max(v, _LOWEST_PX) for v in values], label=name)
        for one, what in zip(axes, ("median", "95th percentile"), strict=True):
            one.set(yscale="log", xlabel="frame", title=f"{what} of the vertices in sight")
            one.yaxis.set_major_formatter("{x:g}")
            one.margins(x=0.01)
        axes[0].set_ylabel("end-point error, px")
        handles, names = axes[0].get_legend_handles_labels()
        figure.legend(handles, names, ncols=len(names), loc="outside lower center", handlelength=3)
        if title:
            figure.suptitle(title)
    write_figure(figure, path)


def write_moments(path: Path, moments: Mapping[str, Mapping[int, Picture]]) -> None:
    """Write a PNG of each method's last pictures (h, w, 3), by frame: methods are columns, frames rows."""
    every = [picture for pictures in moments.values() for picture in pictures.values()]
    drawn = np.any([picture.any(axis=2) for picture in every], axis=0)
    frames = list(next(iter(moments.values())))[-_MOMENTS:]
    rows = [
        {name: cropped([pictures[frame]], drawn)[0] for name, pictures in moments.items()} for frame in frames
    ]
    write_tiles(path, rows, [f"frame {frame}" for frame in frames], height_px=_MOMENT_PX)
