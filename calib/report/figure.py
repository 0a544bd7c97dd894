"""Matplotlib figures as inline SVG with the colours of the page: light mode, dark mode and print.

The colours are those of Okabe and Ito (jfly.uni-koeln.de/color), which remain distinct for the common kinds of colour blindness,
darkened or lightened where the page's background requires contrast. `before`, `refit` and `after` also differ in their dashes.
"""

from __future__ import annotations

import io
import itertools
import re
from collections.abc import Sequence
from typing import Any
from xml.etree import ElementTree

import matplotlib
import numpy as np
from markupsafe import Markup
from matplotlib.axes import Axes
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from matplotlib.legend import Legend
from matplotlib.text import Text

# role -> the colour that a figure is drawn with; page.css gives each role its colour in light and dark mode
ROLES = {
    "ink": "#1b1f24",
    "muted": "#5f6770",
    "grid": "#d5d9de",
    "before": "#c44e00",
    "refit": "#a8437f",
    "after": "#0072b2",
    "good": "#00795a",
    "bad": "#b3261e",
    "accent": "#8a6100",
}
LINE: dict[str, dict[str, Any]] = {
    "measured": {"color": ROLES["ink"], "linewidth": 1.0},
    "before": {"color": ROLES["before"], "linewidth": 1.2, "linestyle": (0, (4, 1.5))},
    "refit": {"color": ROLES["refit"], "linewidth": 1.2, "linestyle": (0, (1.5, 1.2))},
    "after": {"color": ROLES["after"], "linewidth": 1.3},
}
_STYLE: Any = {
    "svg.fonttype": "none",
    "svg.hashsalt": "arm-calib",
    "font.size": 9,
    "figure.facecolor": "none",
    "axes.facecolor": "none",
    "axes.edgecolor": ROLES["muted"],
    "axes.labelcolor": ROLES["ink"],
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": ROLES["grid"],
    "grid.linewidth": 0.6,
    "text.color": ROLES["ink"],
    "xtick.color": ROLES["muted"],
    "ytick.color": ROLES["muted"],
}
_SVG = "http://www.w3.org/2000/svg"
_XLINK = "{http://www.w3.org/1999/xlink}href"
# coordinates in points: a hundredth is far below a pixel
_LONG_NUMBER = re.compile(r"(?<![\w#.-])(-?\d+\.\d\d)\d+(?![\w.])")
_count = itertools.count(1)
WIDTH = 10.5  # inches
GAP = 20.0  # median steps; a longer one is a gap in the line


def axes(rows: int = 1, columns: int = 1, height: float = 2.4, **options: Any) -> tuple[Figure, np.ndarray]:
    """A figure in the style of the pages with rows x columns axes (always a 2-D array); height: of one row, inches."""
    with matplotlib.rc_context(_STYLE):
        figure = Figure(figsize=(WIDTH, height * rows), layout="constrained")
        grid = figure.subplots(rows, columns, squeeze=False, **options)
    return figure, grid


def mosaic(
    layout: Sequence[Sequence[str]], width: float = WIDTH, height: float = 2.4, **options: Any
) -> tuple[Figure, dict[str, Axes]]:
    """A figure in the style of the pages with named axes (matplotlib's subplot_mosaic); inches, height: of one row."""
    with matplotlib.rc_context(_STYLE):
        figure = Figure(figsize=(width, height * len(layout)), layout="constrained")
        return figure, figure.subplot_mosaic([list(row) for row in layout], **options)


def svg(figure: Figure, title: str, playheads: Sequence[Axes] = ()) -> Markup:
    """`figure` as inline SVG without style attributes, with `title` as its text alternative.

    Axes in `playheads`, which have time along x, get a vertical line that the player of a plan moves.

    Every inline style becomes a presentation attribute or a class, so that the page needs no exception from its content policy.
    """
    text = io.StringIO()
    for words in figure.findobj(Text):
        words.set_parse_math(False)
    for legend in figure.findobj(Legend):
        legend.set_frame_on(False)
    with matplotlib.rc_context(_STYLE):
        # savefig draws twice, once for the layout alone
        engine = figure.get_layout_engine()
        if engine is not None:
            engine.execute(figure)
        figure.set_layout_engine("none")
        FigureCanvasSVG(figure).print_svg(text, metadata={"Date": None, "Creator": None, "Type": None, "Format": None})
    ElementTree.register_namespace("", _SVG)
    ElementTree.register_namespace("xlink", "http://www.w3.org/1999/xlink")
    root = ElementTree.fromstring(text.getvalue())
    prefix = f"f{next(_count)}-"
    for parent in root.iter():
        for child in [c for c in parent if c.tag == f"{{{_SVG}}}style"]:
            parent.remove(child)
    for element in root.iter():
        _restyle(element)
        _rename(element, prefix)
    for size in ("width", "height"):
        root.attrib.pop(size, None)
    root.set("role", "img")
    root.set("aria-labelledby", f"{prefix}title")
    label = ElementTree.Element(f"{{{_SVG}}}title", {"id": f"{prefix}title"})
    label.text = title
    root.insert(0, label)
    root.extend(_playhead(figure, ax) for ax in playheads)
    for element in root.iter():  # text in a figure keeps its digits
        element.attrib.update({key: _LONG_NUMBER.sub(r"\1", value) for key, value in element.attrib.items()})
    return Markup(re.sub(r"\s*\n\s*", "\n", ElementTree.tostring(root, encoding="unicode")))


def name(ax: Axes, title: str = "", x: str = "", y: str = "") -> None:
    """Set the title (small, at the left) and the axis labels (units in brackets)."""
    if title:
        ax.set_title(title, loc="left", fontsize=9)
    ax.set_xlabel(x)
    ax.set_ylabel(y)


def draw_line(ax: Axes, x: np.ndarray, y: np.ndarray, points: int = 500, **style: Any) -> None:
    """Draw a line over ascending x, thinned by `envelope` so that no peak is lost on the page.

    A gap in x is a gap in the line.
    """
    x, y = np.asarray(x, dtype=float), np.asarray(y, dtype=float)
    steps = np.diff(x)
    gaps = np.flatnonzero(steps > GAP * np.median(steps)) + 1 if len(steps) else np.zeros(0, dtype=int)
    x, y = np.insert(x, gaps, x[gaps]), np.insert(y, gaps, np.nan)
    kept = envelope(y, points)
    ax.plot(x[kept], y[kept], **style)


def envelope(y: np.ndarray, points: int) -> np.ndarray:
    """Ascending indices of the ends of y (N,) and of the least and greatest value in each of `points` sections; all if N <= 2 * points.

    A section with a NaN keeps it, so that a gap in the data stays a gap on the page.
    """
    y = np.asarray(y, dtype=float)
    if len(y) <= 2 * points:
        return np.arange(len(y))
    edges = np.linspace(0, len(y), points + 1).astype(int)
    stretch, holes = np.repeat(np.arange(points), np.diff(edges)), np.isnan(y)
    least = np.minimum.reduceat(np.where(holes, np.inf, y), edges[:-1])[stretch]
    most = np.maximum.reduceat(np.where(holes, -np.inf, y), edges[:-1])[stretch]
    kept = [np.array([0, len(y) - 1])]
    for wanted in (holes, y == least, y == most):
        found = np.flatnonzero(wanted)
        kept.append(found[np.unique(stretch[found], return_index=True)[1]])  # the first of each stretch
    return np.unique(np.concatenate(kept))


def _playhead(figure: Figure, ax: Axes) -> ElementTree.Element:
    box, (width, height) = ax.get_position(), 72 * figure.get_size_inches()
    t0, t1 = ax.get_xlim()
    numbers = {"x1": box.x0 * width, "x2": box.x0 * width, "y1": (1 - box.y1) * height, "y2": (1 - box.y0) * height}
    data = {"data-x0": box.x0 * width, "data-x1": box.x1 * width, "data-t0": t0, "data-t1": t1}
    values = {key: f"{value:.3f}" for key, value in (numbers | data).items()}
    return ElementTree.Element(f"{{{_SVG}}}line", values | {"class": "playhead"})


def _restyle(element: ElementTree.Element) -> None:
    style = element.attrib.pop("style", None)
    if style is None:
        return
    classes = []
    for declaration in style.split(";"):
        key, _, value = (part.strip() for part in declaration.partition(":"))
        role = next((r for r, colour in ROLES.items() if value.lower() == colour), None)
        if key in ("fill", "stroke") and role:
            classes.append(f"{key}-{role}")
        elif key and key not in ("font-family", "font"):
            element.set(key, value)
    if classes:
        element.set("class", " ".join(classes))


def _rename(element: ElementTree.Element, prefix: str) -> None:
    for key, value in list(element.attrib.items()):
        if key == "id":
            element.set(key, prefix + value)
        elif key == _XLINK and value.startswith("#"):
            element.set(key, "#" + prefix + value[1:])
        elif value.startswith("url(#"):
            element.set(key, "url(#" + prefix + value[5:])
