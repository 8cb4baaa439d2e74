"""The report is one file, complete, escaped, the same for the same content."""

import base64
import re
from html.parser import HTMLParser
from pathlib import Path

import cv2
import numpy as np
from matplotlib.axes import Axes
from rich.table import Table
from rich.text import Text

from extremal.scripts.report import Report, pipe_table
from extremal.scripts.report_figure import INK, MOST_PATHS

VOID = {"meta", "link", "img", "br"}
MARKUP = '<script>alert("a & b")</script>'


class Reader(HTMLParser):
    """Checks that tags are balanced, and keeps elements and text."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.elements: list[tuple[str, dict[str, str]]] = []
        self.words = ""
        self.feed(page)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, {k: v or "" for k, v in attrs}))
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, {k: v or "" for k, v in attrs}))

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.words += data

    def all(self, tag: str) -> list[dict[str, str]]:
        return [attributes for name, attributes in self.elements if name == tag]


def line(axes: Axes) -> None:
    axes.plot([0, 1], [2, 3])
    axes.set_xlabel("R [mm]")


def full_report() -> Report:
    table = Table(title="radii [mm]", caption="medians")
    table.add_column("name")
    table.add_column("R", justify="right")
    table.add_row("vase", "40")
    table.add_row(Text("box"), "[0, 1]")
    image = np.random.default_rng(0).integers(0, 255, (30, 40, 3)).astype(np.uint8)
    report = Report("A title", "a subtitle").facts({"points": "12"}).section("Part").text("words")
    report.figure(line, "a line").figure(line, "another").picture(image, "noise").table(table)
    return report.settings({"views": 3, "motion": {"baseline": 0.1 + 0.2}, "arm": None, "seed": 7})


def test_every_part_is_there_and_the_document_is_well_formed() -> None:
    page = full_report().html()
    reader = Reader(page)
    for words in (
        "A title",
        "a subtitle",
        "points",
        "12",
        "Part",
        "words",
        "radii [mm]",
        "medians",
        "[0, 1]",
    ):
        assert words in reader.words
    for words in ("motion.baseline", "0.3", "seed", "7", "extremal", "python"):
        assert words in reader.words
    figures = [a for a in reader.all("svg") if a.get("role") == "img"]
    assert [a["aria-label"] for a in figures] == ["a line", "another"]
    assert all(a["alt"] for a in reader.all("img"))
    assert [a.get("class") for a in reader.all("td")] == [None, "number"] * 2


def test_nothing_is_loaded_from_elsewhere() -> None:
    page = full_report().html()
    for _, attributes in Reader(page).elements:
        for name in ("src", "href", "xlink:href"):
            assert attributes.get(name, "#").startswith(("#", "data:"))
    assert not re.search(r"@import|url\((?!#)", page)
    assert "default-src 'none'" in page


def test_all_text_is_escaped() -> None:
    table = Table(title=MARKUP, caption=MARKUP)
    table.add_column(MARKUP)
    table.add_row(MARKUP)
    image = np.zeros((3, 4), np.uint8)
    report = Report(MARKUP, MARKUP).facts({MARKUP: MARKUP}).section(MARKUP).text(MARKUP).table(table)
    report.figure(line, MARKUP).picture(image, MARKUP).settings({MARKUP: MARKUP})
    reader = Reader(report.html())
    assert reader.all("script") == []
    assert reader.words.count(MARKUP) == 15


def test_figures_take_the_colour_of_the_page() -> None:
    page = Report("t").figure(line, "a line").html()
    assert INK not in page and page.count("currentColor") > 5
    assert not re.search(r"(fill|stroke): #(fff|000)", page)  # neither white grounds nor black lines


def test_a_figure_of_many_pieces_is_drawn_as_pixels() -> None:
    def bars(axes: Axes, n: int) -> None:
        axes.errorbar(np.arange(n), np.zeros(n), np.ones(n), fmt="none")

    few = Report("t").figure(lambda axes: bars(axes, MOST_PATHS), "few").html()
    many = Report("t").figure(lambda axes: bars(axes, 20 * MOST_PATHS), "many").html()
    assert "<image" not in few and "<image" in many
    assert len(many) < 200_000


def test_the_same_content_is_the_same_text() -> None:
    assert full_report().html() == full_report().html()


def test_a_picture_keeps_its_colours() -> None:
    image = np.zeros((40, 2000, 3), np.uint8)
    image[..., 0] = 200  # red
    (element,) = Reader(Report("t").picture(image, "red").html()).all("img")
    data = base64.b64decode(element["src"].partition(",")[2])
    stored = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
    assert stored is not None and stored.shape[1] == 1280
    np.testing.assert_allclose(stored.reshape(-1, 3).mean(axis=0), (0, 0, 200), atol=4)


def test_saving_leaves_one_file(tmp_path: Path) -> None:
    report = full_report()
    report.save(tmp_path / "report.html")
    assert [p.name for p in tmp_path.iterdir()] == ["report.html"]
    assert (tmp_path / "report.html").read_text(encoding="utf-8") == report.html()


def test_a_markdown_table() -> None:
    table = pipe_table("|  | R [mm] |\n| --- | ---: |\n| vase | 40 |\n| box | - |", "radii")
    assert [c.header for c in table.columns] == ["", "R [mm]"] and table.title == "radii"
    assert [list(c.cells) for c in table.columns] == [["vase", "box"], ["40", "-"]]
    assert [c.justify for c in table.columns] == ["left", "right"]
