"""Reports: one HTML file that holds everything it shows, needs no network and can be mailed."""

import base64
import platform
from collections.abc import Mapping
from html import escape
from importlib.metadata import version
from importlib.resources import files
from itertools import groupby
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from rich.table import Table
from rich.text import Text

from extremal.estimator.files import write_whole
from extremal.scripts.report_figure import SIZE, Draw, svg_of
from extremal.scripts.report_scene import Scene3D

PACKAGES = ("extremal", "mujoco", "numpy", "scipy", "opencv-python-headless", "viser")
PICTURE_WIDTH, PICTURE_QUALITY = 1280, 82  # [px] at most, of JPEG
# The browser itself refuses whatever is not in the file; the 3D view's document inherits this.
POLICY = (
    "default-src 'none'; script-src 'unsafe-inline' 'unsafe-eval' blob:; worker-src blob:; "
    "style-src 'unsafe-inline'; img-src data: blob:; connect-src data: blob:; font-src data:"
)


class Report:
    """A report is a list of parts; what adds one returns the report:

        Report("A look", "vase, seed 1").facts({"R": "40 mm"}).figure(draw, "R over looks").save(path)

    All text is escaped.
    """

    def __init__(self, title: str, subtitle: str = "") -> None:
        self._title, self._subtitle = title, subtitle
        self._parts: list[tuple[str, str]] = []  # kind and HTML

    def text(self, text: str) -> "Report":
        """Add a paragraph."""
        return self._add("text", f"<p>{escape(text)}</p>")

    def section(self, title: str) -> "Report":
        """Add a heading."""
        return self._add("section", f"<h2>{escape(title)}</h2>")

    def facts(self, facts: Mapping[str, str]) -> "Report":
        """Add the numbers that matter most, by their names."""
        items = "".join(f"<div><dt>{escape(k)}</dt><dd>{escape(v)}</dd></div>" for k, v in facts.items())
        return self._add("facts", f'<dl class="facts">{items}</dl>')

    def table(self, table: Table) -> "Report":
        """Add a table as the terminal shows it, with its title and caption."""
        title, caption = _plain(table.title), _plain(table.caption)
        sides = ['class="number"' if column.justify == "right" else "" for column in table.columns]
        head = "".join(
            f"<th {side}>{_plain(column.header)}</th>"
            for column, side in zip(table.columns, sides, strict=True)
        )
        rows = zip(*(column.cells for column in table.columns), strict=True)
        body = "".join(
            "<tr>" + "".join(f"<td {s}>{_plain(c)}</td>" for c, s in zip(row, sides, strict=True)) + "</tr>"
            for row in rows
        )
        inner = (
            f"<table><caption>{title}</caption><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"
        )
        below = f'<p class="note">{caption}</p>' if caption else ""
        return self._add("table", f'<div class="wide" tabindex="0">{inner}</div>{below}')

    def figure(self, draw: Draw, caption: str, size: tuple[float, float] = SIZE) -> "Report":
        """Add what `draw(axes)` draws, without a background, in inches; neighbours share a row where there is room."""
        return self._add("figure", _figure(svg_of(draw, caption, size), caption))

    def picture(self, image: NDArray[np.uint8], caption: str) -> "Report":
        """Add an image (height, width), grey, or (height, width, 3), RGB."""
        element = f'<img alt="{escape(caption, quote=True)}" src="{_jpeg(image)}">'
        return self._add("picture", _figure(element, caption))

    def scene(self, scene: Scene3D, caption: str) -> "Report":
        """Add a 3D view; one costs about a megabyte."""
        page = scene.html().replace("&", "&amp;").replace('"', "&quot;")
        title = escape(caption, quote=True)
        frame = f'<iframe loading="lazy" title="{title}" srcdoc="{page}"></iframe>'
        return self._add("scene", _figure(frame, caption))

    def settings(self, settings: Mapping[str, Any]) -> "Report":
        """Add the settings, the seed among them, and the versions of everything that computed."""
        versions = {name: version(name) for name in PACKAGES} | {"python": platform.python_version()}
        groups = (("Settings", _flat(settings)), ("Versions", versions))
        parts = "".join(
            f"<details open><summary>{name}</summary><dl>"
            + "".join(f"<dt>{escape(k)}</dt><dd>{escape(_short(v))}</dd>" for k, v in values.items())
            + "</dl></details>"
            for name, values in groups
        )
        return self._add("settings", f'<div class="settings">{parts}</div>')

    def save(self, path: Path) -> None:
        """Write the file, whole or not at all."""
        write_whole(path, self.html())

    def html(self) -> str:
        """The report as one document."""
        body = ""
        for kind, group in groupby(self._parts, key=lambda part: part[0]):
            inner = "\n".join(html for _, html in group)
            body += f'<div class="figures">\n{inner}\n</div>\n' if kind == "figure" else f"{inner}\n"
        style = files("extremal.scripts").joinpath("report.css").read_text(encoding="utf-8")
        title = escape(self._title)
        return (
            f'<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n<title>{title}</title>\n'
            f'<meta http-equiv="Content-Security-Policy" content="{POLICY}">\n'
            '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
            '<meta name="color-scheme" content="light dark">\n'
            f'<link rel="icon" href="data:,">\n<style>\n{style}</style>\n</head>\n<body>\n<main>\n'
            f"<header><h1>{title}</h1><p>{escape(self._subtitle)}</p></header>\n{body}</main>\n</body>\n</html>\n"
        )

    def _add(self, kind: str, html: str) -> "Report":
        self._parts.append((kind, html))
        return self


def _figure(element: str, caption: str) -> str:
    return f"<figure>{element}<figcaption>{escape(caption)}</figcaption></figure>"


def _plain(value: Any) -> str:
    """A cell, title or caption of a table, escaped; units in brackets are no markup."""
    return "" if value is None else escape(value.plain if isinstance(value, Text) else str(value))


def pipe_table(text: str, title: str = "") -> Table:
    """A table in GitHub's Markdown as a table of the terminal."""
    lines = [line.strip().removeprefix("|").removesuffix("|") for line in text.strip().splitlines()]
    head, sides, *rows = ([cell.strip() for cell in line.split("|")] for line in lines)
    table = Table(title=title or None)
    for name, side in zip(head, sides, strict=True):
        table.add_column(name, justify="right" if side.endswith(":") else "left")
    for row in rows:
        table.add_row(*row)
    return table


def _flat(settings: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    found: dict[str, Any] = {}
    for name, value in settings.items():
        found |= _flat(value, f"{prefix}{name}.") if isinstance(value, Mapping) else {prefix + name: value}
    return found


def _short(value: Any) -> str:
    return f"{value:.6g}" if isinstance(value, float) else "-" if value is None else str(value)


def _jpeg(image: NDArray[np.uint8]) -> str:
    """An image as a data URI."""
    height, width = image.shape[:2]
    if width > PICTURE_WIDTH:
        size = (PICTURE_WIDTH, max(1, round(height * PICTURE_WIDTH / width)))
        image = cv2.resize(image, size, interpolation=cv2.INTER_AREA).astype(np.uint8)
    stored = cv2.cvtColor(image, cv2.COLOR_RGB2BGR) if image.ndim == 3 else image
    _, data = cv2.imencode(".jpg", stored, [cv2.IMWRITE_JPEG_QUALITY, PICTURE_QUALITY])
    return "data:image/jpeg;base64," + base64.b64encode(data.tobytes()).decode("ascii")
