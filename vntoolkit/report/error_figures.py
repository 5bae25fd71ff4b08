"""Figures of errors: over time (Figure 7 of brostow2011), over the image, and cumulative."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from vntoolkit.arrays import FloatArray, Mask
from vntoolkit.io.atomic import atomic_path

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_CURVE_END_PERCENTILE = 99.0


def write_error_over_time(
    path: Path | str, times_s: FloatArray, mean_deg: FloatArray, std_deg: FloatArray, title: str
) -> None:
    """Plot mean and standard deviation (frames,) in degrees over time in seconds."""
    figure, axes = _figure(7.0, 3.2)
    axes.plot(times_s, mean_deg, color="tab:blue", label="mean")
    axes.fill_between(
        times_s, mean_deg - std_deg, mean_deg + std_deg, color="tab:blue", alpha=0.2, label="± one std"
    )
    axes.set_xlabel("time, s")
    axes.set_ylabel("angle to the fitted cylinder, degrees")
    axes.set_ylim(bottom=0)
    axes.set_title(title, fontsize=10)
    axes.legend(fontsize=8)
    axes.grid(alpha=0.3)
    _write(figure, path)


def write_error_map(path: Path | str, errors: FloatArray, mask: Mask, title: str, unit: str) -> None:
    """Draw errors (h, w) as an image, grey outside the mask, up to the 99th percentile."""
    figure, axes = _figure(6.0, 6.0 * errors.shape[0] / errors.shape[1] + 0.6)
    top = float(np.percentile(errors[mask], _CURVE_END_PERCENTILE)) if mask.any() else 1.0
    axes.set_facecolor("0.85")
    shown = axes.imshow(np.ma.masked_array(errors, ~mask), cmap="inferno", vmin=0, vmax=max(top, 1e-12))
    figure.colorbar(shown, ax=axes, label=unit, fraction=0.04)
    axes.set_xticks([])
    axes.set_yticks([])
    axes.set_title(title, fontsize=10)
    _write(figure, path)


def write_cumulative_errors(
    path: Path | str, errors: Mapping[str, FloatArray], title: str, unit: str
) -> None:
    """Plot, for each name, the share of values (n,) that are at most as large as x."""
    figure, axes = _figure(6.0, 3.6)
    end = 0.0
    for name, values in errors.items():
        ordered = np.sort(np.asarray(values).ravel())
        shares = np.arange(1, len(ordered) + 1) / len(ordered)
        step = max(1, len(ordered) // 2000)
        axes.plot(ordered[::step], 100 * shares[::step], label=name)
        end = max(end, float(np.percentile(ordered, _CURVE_END_PERCENTILE)))
    axes.set_xlim(0, end or 1.0)
    axes.set_ylim(0, 100)
    axes.set_xlabel(unit)
    axes.set_ylabel("share below, %")
    axes.set_title(title, fontsize=10)
    axes.legend(fontsize=8)
    axes.grid(alpha=0.3)
    _write(figure, path)


def write_bars(
    path: Path | str, names: Sequence[str], groups: Mapping[str, Sequence[float]], title: str, unit: str
) -> None:
    """Draw a group of horizontal bars for each name, one bar for each of `groups`."""
    figure, axes = _figure(6.5, 0.9 + 0.32 * len(names))
    at, height = np.arange(len(names)), 0.8 / len(groups)
    for i, (group, values) in enumerate(groups.items()):
        axes.barh(at + (i - (len(groups) - 1) / 2) * height, values, height, label=group)
    axes.set_yticks(at, names, fontsize=8)
    axes.invert_yaxis()
    axes.set_xlabel(unit)
    axes.set_title(title, fontsize=10)
    figure.legend(fontsize=8, ncols=2, loc="outside lower center")  # bars reach everywhere
    axes.grid(alpha=0.3, axis="x")
    _write(figure, path)


def _figure(width: float, height: float) -> tuple[Figure, Any]:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), dpi=120, layout="constrained")
    return figure, figure.add_subplot()


def _write(figure: Figure, path: Path | str) -> None:
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    FigureCanvasAgg(figure)
    with atomic_path(path) as temporary:
        figure.savefig(temporary, format="png", metadata={"Software": None})
