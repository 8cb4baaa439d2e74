"""Figures of a report: drawings on matplotlib's axes as inline SVG, in the colour of the page's text."""

import io
import re
from collections.abc import Callable
from html import escape
from typing import Any

import matplotlib
from matplotlib.axes import Axes
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.collections import Collection
from matplotlib.figure import Figure

SIZE = (5.2, 3.9)  # [in] of a figure: legible when a phone shows it at two thirds
INK = "#010203"  # stands for the page's colour of text
MOST_PATHS = 300  # of a collection that stays drawn by curves; one with more becomes pixels
STYLE: Any = {
    "axes.edgecolor": INK,
    "axes.facecolor": "none",
    "axes.labelcolor": INK,
    "axes.titlesize": 10,
    "figure.facecolor": "none",
    "font.size": 10,
    "grid.color": "#888888",
    "legend.facecolor": "none",
    "legend.edgecolor": "none",
    "legend.labelcolor": INK,
    "savefig.facecolor": "none",
    "svg.fonttype": "path",  # the reader's fonts would not fit
    "svg.hashsalt": "extremal",  # the same figure, the same text
    "text.color": INK,
    "xtick.color": INK,
    "ytick.color": INK,
}
Draw = Callable[[Axes], object]


def svg_of(draw: Draw, description: str, size: tuple[float, float] = SIZE) -> str:
    """An inline SVG element of what `draw` draws; `description` is its alternative text."""
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=size, layout="constrained")
        FigureCanvasSVG(figure)
        draw(figure.add_subplot())
        for artist in figure.findobj(lambda a: isinstance(a, Collection) and len(a.get_paths()) > MOST_PATHS):
            artist.set_rasterized(True)
        text = io.StringIO()
        figure.savefig(text, format="svg", dpi=200, metadata={"Date": None})
    svg = text.getvalue()
    svg = re.sub(r"<metadata>.*?</metadata>", "", svg[svg.index("<svg") :], flags=re.DOTALL)
    svg = re.sub(r'(<svg[^>]*?) width="[^"]*"', r"\1", svg, count=1)
    svg = re.sub(r'(<svg[^>]*?) height="[^"]*"', r"\1", svg, count=1)
    label = f'<svg role="img" aria-label="{escape(description, quote=True)}"'
    return svg.replace("<svg", label, 1).replace(INK, "currentColor")
