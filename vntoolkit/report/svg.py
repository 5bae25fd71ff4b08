"""Matplotlib figures in the report's own style, as SVG that stands inside a page."""

from __future__ import annotations

import hashlib
import io
import re
from contextlib import AbstractContextManager
from typing import TYPE_CHECKING, Any, cast

if TYPE_CHECKING:
    from matplotlib.figure import Figure

INK, FAINT = "#27313f", "#8793a3"
BLUE, ORANGE, GREEN, RED, PURPLE = "#3b6fb6", "#d9822b", "#3f9163", "#c0443c", "#7b5aa6"
_STYLE = {
    "svg.fonttype": "none",  # text stays text: smaller, sharp, can be searched
    "font.family": "sans-serif",
    "font.size": 9.0,
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
    "lines.linewidth": 1.6,
}


def new_figure(width_in: float = 6.2, height_in: float = 2.9) -> Figure:
    """Return an empty figure in the report's style; draw on it inside `report_style`."""
    from matplotlib.figure import Figure

    return Figure(figsize=(width_in, height_in), layout="constrained")


def report_style(**more: Any) -> AbstractContextManager[None]:
    """Draw in the report's style while the block runs."""
    import matplotlib

    return matplotlib.rc_context(cast(Any, {**_STYLE, **more}))


def svg_from_figure(figure: Figure) -> str:
    """Return `<svg …>…</svg>` without prolog, comments, dates or metadata, its ids unlike any other figure's.

    The same figure gives the same text.
    """
    stream = io.StringIO()
    with report_style(**{"svg.hashsalt": "vntoolkit"}):
        figure.savefig(
            stream,
            format="svg",
            transparent=True,
            metadata={"Date": None, "Creator": None, "Format": None, "Type": None},
        )
    text = stream.getvalue()
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>", "", text, flags=re.DOTALL)
    text = re.sub(r"<!--.*?-->", "", text, flags=re.DOTALL)
    mark = "f" + hashlib.sha256(text.encode()).hexdigest()[:8]
    text = re.sub(r'(\bid="|url\(#|href="#)', rf"\g<1>{mark}-", text)
    # the page sets the width; the viewBox keeps the proportions
    head, tail = text.split(">", 1)
    head = re.sub(r'\s(width|height)="[^"]*"', "", head)
    return f'{head} role="img">{tail}'.strip()
