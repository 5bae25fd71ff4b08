"""Error against frame, one curve a method: the picture of which tracker drifts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from vntoolkit.evaluation.track_error import TrackError
from vntoolkit.report.style import new_figure, report_style, write_figure

_LOWEST_PX = 0.05


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
