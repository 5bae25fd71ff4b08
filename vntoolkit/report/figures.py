"""Figures of errors over time, over the image, cumulative, as bars (brostow2011, 7); of shadows (4, 5)."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from vntoolkit.arrays import FloatArray, Mask
from vntoolkit.evaluation.track_error import TrackError
from vntoolkit.report import pictures

_CURVE_END_PERCENTILE = 99.0
_MEDIAN_PERCENT = 50
_LOWEST_PX = 0.05
_MOMENTS, _MOMENT_PX = 3, 220


def write_error_over_time(
    path: Path | str, times_s: FloatArray, mean_deg: FloatArray, std_deg: FloatArray, title: str
) -> None:
    """Plot mean and standard deviation (frames,) in degrees over time in seconds."""
    with pictures.new_axes(7.0, 3.0) as axes:
        few: dict[str, Any] = {"marker": "o", "markersize": 3.5} if len(times_s) < 60 else {}
        axes.plot(times_s, mean_deg, color=pictures.BLUE, label="mean", **few)
        low = np.maximum(mean_deg - std_deg, 0)
        axes.fill_between(
            times_s, low, mean_deg + std_deg, color=pictures.BLUE, alpha=0.15, lw=0, label="± one std"
        )
        axes.set(xlabel="time, s", ylabel="angle to the cylinder, °", ylim=(0, None), title=title)
        axes.margins(x=0.01)
        axes.figure.legend(ncols=2, loc="outside lower center")
    pictures.write_figure(axes.figure, path)


def write_error_map(path: Path | str, errors: FloatArray, mask: Mask, title: str, unit: str) -> None:
    """Draw errors (h, w) as an image, grey outside the mask, up to the 99th percentile."""
    with pictures.new_axes(
        6.0, 5.4 * errors.shape[0] / errors.shape[1] + 0.5, **{"axes.grid": False}
    ) as axes:
        top = float(np.percentile(errors[mask], _CURVE_END_PERCENTILE)) if mask.any() else 1.0
        axes.set_facecolor("0.85")
        masked = np.ma.masked_array(errors, ~mask)
        shown = axes.imshow(masked, cmap=pictures.ERROR_COLOURS, vmin=0, vmax=max(top, 1e-12))
        bar = axes.figure.colorbar(shown, ax=axes, label=unit, fraction=0.04, extend="max")
        bar.outline.set_visible(False)
        axes.set(xticks=[], yticks=[], title=title)
        axes.spines[:].set_visible(False)
    pictures.write_figure(axes.figure, path)


def write_cumulative_errors(
    path: Path | str, errors: Mapping[str, FloatArray], title: str, unit: str
) -> None:
    """Plot, for each name, the share of values (n,) that are at most as large as x; a dot at the median."""
    with pictures.new_axes(6.0, 3.2) as axes:
        end = 0.0
        for name, values in errors.items():
            ordered = np.sort(np.asarray(values).ravel())
            shares = 100 * np.arange(1, len(ordered) + 1) / len(ordered)
            step = max(1, len(ordered) // 2000)
            median = float(np.median(ordered))
            (line,) = axes.plot(ordered[::step], shares[::step], label=f"{name}, median {median:.3g}")
            axes.plot(median, _MEDIAN_PERCENT, "o", ms=4.5, color=line.get_color())
            end = max(end, float(np.percentile(ordered, _CURVE_END_PERCENTILE)))
        axes.set(
            xlim=(0, end or 1.0), ylim=(0, 101), xlabel=unit, ylabel="share at most as large, %", title=title
        )
        axes.legend(loc="lower right")
    pictures.write_figure(axes.figure, path)


def write_profile(path: Path, table: Path) -> None:
    """Draw the heights of a table of `export --to profile` over its distances; gaps stay gaps."""
    names = table.read_text("utf-8").split("\n", 1)[0].split(",")
    distances, heights = np.genfromtxt(table, delimiter=",", skip_header=1, ndmin=2, unpack=True)
    labels = [name.replace("_", ", ") for name in names]
    with pictures.new_axes(7.0, 2.8) as axes:
        axes.plot(distances, heights)
        axes.set(xlabel=labels[0], ylabel=labels[1], xlim=(distances[0], distances[-1]))
    pictures.write_figure(axes.figure, path)


def write_bars(
    path: Path | str, names: Sequence[str], groups: Mapping[str, Sequence[float]], title: str, unit: str
) -> None:
    """Draw a group of horizontal bars for each name, one bar for each of `groups`; NaN draws none.

    Each bar carries its value.
    """
    with pictures.new_axes(7.0, 0.9 + 0.17 * len(names) * (len(groups) + 0.8)) as axes:
        at, height = np.arange(len(names)), 0.82 / len(groups)
        for i, (group, values) in enumerate(groups.items()):
            places = at + (i - (len(groups) - 1) / 2) * height
            bars = axes.barh(
                places, values, 0.9 * height, label=group, color=pictures.SERIES[i % len(pictures.SERIES)]
            )
            written = ["" if np.isnan(value) else f"{value:.1f}" for value in values]
            axes.bar_label(bars, written, fontsize=7, padding=2, color=pictures.INK)
        axes.set_yticks(at, names)
        axes.invert_yaxis()
        axes.tick_params(axis="y", length=0)
        axes.spines["left"].set_visible(False)
        axes.grid(visible=False, axis="y")
        axes.set(xlabel=unit, title=title)
        axes.figure.legend(ncols=min(4, len(groups)), loc="outside lower center")  # bars reach everywhere
    pictures.write_figure(axes.figure, path)


# Comparison of trackers: errors over the frames, and pictures of their checkerboards.


def write_error_plot(path: Path, errors: Mapping[str, Sequence[TrackError]]) -> None:
    """Write a PNG or SVG (by the suffix) of median and 95 % error in pixels by frame, on log scales."""
    with pictures.report_style():
        figure = pictures.new_figure(9.6, 3.6)
        axes = figure.subplots(1, 2, sharex=True, sharey=True)
        for name, series in errors.items():
            frames = [error.frame for error in series]
            columns = ([error.median_px for error in series], [error.p95_px for error in series])
            for one, values in zip(axes, columns, strict=True):
                one.plot(frames, [max(v, _LOWEST_PX) for v in values], label=name)
        for one, what in zip(axes, ("median", "95th percentile"), strict=True):
            one.set(yscale="log", xlabel="frame", title=f"{what} of the visible vertices")
            one.yaxis.set_major_formatter("{x:g}")
            one.margins(x=0.01)
        axes[0].set_ylabel("end-point error, px")
        handles, names = axes[0].get_legend_handles_labels()
        figure.legend(handles, names, ncols=len(names), loc="outside lower center", handlelength=3)
    pictures.write_figure(figure, path)


def write_moments(path: Path, moments: Mapping[str, Mapping[int, pictures.Picture]]) -> None:
    """Write a PNG of each method's last pictures (h, w, 3), by frame: methods are columns, frames rows."""
    every = [picture for by_frame in moments.values() for picture in by_frame.values()]
    drawn = np.any([picture.any(axis=2) for picture in every], axis=0)
    frames = list(next(iter(moments.values())))[-_MOMENTS:]
    rows = [
        {name: pictures.cropped([by_frame[frame]], drawn)[0] for name, by_frame in moments.items()}
        for frame in frames
    ]
    pictures.write_tiles(path, rows, [f"frame {frame}" for frame in frames], height_px=_MOMENT_PX)
