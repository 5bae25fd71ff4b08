"""Error against frame, one curve a method: the picture of which tracker drifts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from vntoolkit.evaluation.track_error import TrackError
from vntoolkit.io.atomic import atomic_path

_LOWEST_PX = 0.05


def write_error_plot(path: Path, errors: Mapping[str, Sequence[TrackError]], title: str = "") -> None:
    """Write a PNG or SVG (by the suffix) of median and 95 % error in pixels by frame, on log scales."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10.0, 4.2), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(1, 2, sharex=True, sharey=True)
    for name, series in errors.items():
        frames = [error.frame for error in series]
        columns = ([error.median_px for error in series], [error.p95_px for error in series])
        for one, values in zip(axes, columns, strict=True):
            one.plot(frames, [max(v, _LOWEST_PX) for v in values], label=name, linewidth=1.4)
    for one, what in zip(axes, ("median", "95 %"), strict=True):
        one.set(yscale="log", xlabel="frame", title=f"{what} of the vertices in sight")
        one.grid(visible=True, which="both", alpha=0.25)
    axes[0].set_ylabel("end-point error in pixels")
    axes[0].legend(fontsize=8)
    figure.suptitle(title)
    with atomic_path(path) as draft:
        figure.savefig(draft, format=path.suffix.lstrip(".") or "png", dpi=110)
