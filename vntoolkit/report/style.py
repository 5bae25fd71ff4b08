"""The common style of all figures, with colours that colour-blind readers can distinguish."""

from __future__ import annotations

from contextlib import AbstractContextManager
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

from vntoolkit.io.atomic import atomic_path

if TYPE_CHECKING:
    from matplotlib.figure import Figure

INK, FAINT, PAPER = "#27313f", "#7d8999", "#ffffff"
# Told apart by all common kinds of colour vision (okabe2008).
BLUE, ORANGE, GREEN, RED, PURPLE, SKY = "#0072b2", "#e69f00", "#009e73", "#d55e00", "#cc79a7", "#56b4e9"
SERIES = (BLUE, ORANGE, GREEN, RED, PURPLE, SKY)
DASHES = ("-", (0, (5, 1.6)), (0, (1.2, 1.2)), (0, (6, 1.4, 1.2, 1.4)), (0, (3, 1)), (0, (8, 2)))
ERROR_COLOURS = "inferno"  # of every map of errors: brighter is worse, in grey print too
PNG_DPI = 160
_STYLE = {
    "svg.fonttype": "none",  # text stays text: smaller, sharp, can be searched
    "font.family": "sans-serif",
    "font.size": 9.0,
    "axes.titlesize": 9.5,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.edgecolor": FAINT,
    "axes.labelcolor": INK,
    "axes.linewidth": 0.8,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": "#e6e9ee",
    "grid.linewidth": 0.8,
    "axes.axisbelow": True,
    "xtick.color": INK,
    "ytick.color": INK,
    "text.color": INK,
    "legend.frameon": False,
    "legend.fontsize": 8.0,
    "lines.linewidth": 1.6,
}


def new_figure(width_in: float = 6.2, height_in: float = 2.9) -> Figure:
    """Return an empty figure in the shared style; draw on it inside `report_style`."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width_in, height_in), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def report_style(**more: Any) -> AbstractContextManager[None]:
    """Draw in the shared style while the block runs: curves differ in colour and in dashes."""
    import matplotlib
    from cycler import cycler

    curves = cycler(color=SERIES) + cycler(linestyle=DASHES)
    return matplotlib.rc_context(cast(Any, {**_STYLE, "axes.prop_cycle": curves, **more}))


def write_figure(figure: Figure, path: Path | str, *, dpi: int = PNG_DPI) -> None:
    """Write a figure as PNG or SVG, by the suffix, atomically; the same figure gives the same bytes."""
    suffix = Path(path).suffix.lower()
    with report_style(**{"svg.hashsalt": "vntoolkit"}), atomic_path(path) as draft:
        if suffix == ".svg":
            figure.savefig(draft, format="svg", metadata={"Date": None, "Creator": None})
        else:
            figure.savefig(draft, format="png", dpi=dpi, metadata={"Software": None})
