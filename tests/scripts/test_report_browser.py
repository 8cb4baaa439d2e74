"""The report of a look in a real browser: nothing is missing, asked for or complained about, in any size and theme."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np
import pytest
from browser import CHROMIUM, Page, opened
from numpy.typing import NDArray
from rich.table import Table

from extremal.scripts.look_report import look_report
from extremal.scripts.report_scene import CAMERA, EXTREMAL, FIXED

if TYPE_CHECKING:
    from conftest import Taken

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(CHROMIUM is None, reason="no Chromium is installed (Debian: chromium)"),
]

FRAME = "document.querySelector('iframe').contentDocument"
TIME = f"[...{FRAME}.querySelectorAll('input')].map(i => i.value).join()"
HUE, STRONG = 8, 90  # 2 degrees of hue by which a colour may differ; least saturation and value
LEAST = 30  # pixels of a colour that is there


@dataclass(frozen=True, eq=False)
class Shown:
    """A report in a window, with a picture of its 3D view, the camera of which ran and was stopped."""

    page: Page
    view: NDArray[np.uint8]
    dark: bool
    width: int


@pytest.fixture(scope="module")
def report(taken: "Taken", tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("report") / "report.html"
    table = Table(title="a table that is wider than a phone")
    for k in range(12):
        table.add_column(f"column {k}")
    table.add_row(*(f"{k} mm" for k in range(12)))
    look_report(taken.scene, "vase-and-box", 0, taken.look, table).save(path)
    return path


@pytest.fixture(scope="module", params=[(800, 600, False), (390, 700, True)], ids=["desk", "dark-phone"])
def shown(report: Path, request: pytest.FixtureRequest) -> Iterator[Shown]:
    width, height, dark = request.param
    with opened(report, width, height, dark) as page:
        page.value("document.querySelector('iframe').scrollIntoView({block: 'center'})")
        page.wait(f"{FRAME}.querySelector('canvas') !== null")
        view = np.zeros((1, 1, 3), np.uint8)

        def drawn() -> bool:
            nonlocal view
            view = page.picture("iframe")[: page.value(f"{FRAME}.querySelector('canvas').clientHeight")]
            return alike(view, FIXED) > LEAST and alike(view, CAMERA) > LEAST

        page.until(drawn, "the 3D view shows contour points and the camera")
        before = page.value(TIME)
        page.until(lambda: page.value(TIME) != before, "the timeline goes on")
        page.value(f"{FRAME}.querySelector('.tabler-icon-player-pause-filled').closest('button').click()")
        yield Shown(page, view, dark, width)


def alike(image: NDArray[np.uint8], colour: tuple[int, int, int]) -> int:
    """Number of pixels of about a colour's hue, however the surfaces before them darken it."""
    hue, strength, value = cv2.split(cv2.cvtColor(image, cv2.COLOR_RGB2HSV).astype(int))
    (wanted,) = cv2.cvtColor(np.array([[colour]], np.uint8), cv2.COLOR_RGB2HSV)[0, :, 0].astype(int)
    off = np.abs((hue - wanted + 90) % 180 - 90)  # OpenCV's hues are in 2 degrees
    return int(((off < HUE) & (strength > STRONG) & (value > STRONG)).sum())


def test_the_page_complains_of_nothing_and_asks_for_nothing(shown: Shown, report: Path) -> None:
    shown.page.value("1")  # take in what was said meanwhile
    assert shown.page.errors == []
    elsewhere = [u for u in shown.page.requests if not u.startswith(("blob:", "data:", "about:"))]
    assert elsewhere == [report.resolve().as_uri()]


def test_the_3d_view_shows_points_of_both_labels_and_the_objects(shown: Shown) -> None:
    assert alike(shown.view, FIXED) > LEAST and alike(shown.view, EXTREMAL) > LEAST
    grey = cv2.cvtColor(shown.view, cv2.COLOR_RGB2GRAY)
    assert len(np.unique(grey)) > 50  # shaded surfaces, not only a ground and marks


def test_nothing_is_wider_than_the_window(shown: Shown) -> None:
    assert shown.page.value("innerWidth") == shown.width
    assert shown.page.value("document.documentElement.scrollWidth") == shown.width
    inside = (
        "[...document.querySelectorAll('main > *')].every(e => e.getBoundingClientRect().right <= innerWidth)"
    )
    assert shown.page.value(inside)


def test_text_stands_out_from_the_page_in_either_theme(shown: Shown) -> None:
    header = shown.page.picture("header").astype(float).mean(axis=2)
    ground = np.median(header)
    assert (ground < 60) if shown.dark else (ground > 200)
    assert np.abs(header - ground).max() > 130
    figure = shown.page.picture(".figures figure:nth-child(2) svg").astype(float).mean(axis=2)
    ground = np.median(figure)
    assert (ground < 80) if shown.dark else (ground > 200)
    assert np.abs(figure - ground).max() > 110
    corner = shown.view[5:15, -15:-5].mean()
    assert (corner < 130) if shown.dark else (corner > 130)


def test_figures_can_be_read_on_a_phone(shown: Shown) -> None:
    """Text of 9 or 10 pt in figures is shown with at least 8 px."""
    widths = shown.page.value(
        "[...document.querySelectorAll('figure > svg')].map(s => s.clientWidth / s.viewBox.baseVal.width)"
    )
    assert len(widths) >= 3 and min(widths) * 10 * 4 / 3 > 8


def test_a_page_that_misbehaves_is_found_out(tmp_path: Path) -> None:
    path = tmp_path / "page.html"
    path.write_text(
        '<!doctype html><title>t</title><img src="http://127.0.0.1:9/x.png"><div style="width: 2000px">wide</div>'
        "<script>console.error('complaint'); setTimeout(() => {throw Error('thrown')})</script>"
    )
    with opened(path, 390, 500) as page:
        page.until(lambda: page.value("1") == 1 and len(page.errors) >= 3, "errors are noted")
        said = " ".join(page.errors)
        assert "complaint" in said and "thrown" in said and "ERR_" in said
        assert "http://127.0.0.1:9/x.png" in page.requests
        assert page.value("document.documentElement.scrollWidth") > 390
