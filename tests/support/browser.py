"""Headless Chromium by its DevTools protocol: what a page shows, says, asks for and complains about."""

import base64
import json
import os
import shutil
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any
from urllib.request import urlopen

import cv2
import numpy as np
from numpy.typing import NDArray
from websockets.sync.client import connect
from websockets.sync.connection import Connection

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
FLAGS = (
    *("--headless", "--remote-debugging-port=0", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"),
    *("--no-first-run", "--disable-quic", "--disable-background-networking", "--disable-component-update"),
    *("--disable-sync", "--hide-scrollbars", "--disable-dev-shm-usage"),
)
PATIENCE = 180.0  # [s] on a busy machine without a GPU


class Page:
    """One page of a browser.

    Attributes:
        errors: what was written to the console as an error, or thrown, or refused by the browser, so far.
        requests: addresses of everything that the page and its frames asked for.
    """

    def __init__(self, socket: Connection, width: int, height: int, dark: bool) -> None:
        self.errors: list[str] = []
        self.requests: list[str] = []
        self._socket, self._number = socket, 0
        for domain in ("Page", "Runtime", "Log", "Network"):
            self._call(f"{domain}.enable")
        size: dict[str, Any] = {
            "width": width,
            "height": height,
            "deviceScaleFactor": 1,
            "mobile": width < 500,
        }
        self._call("Emulation.setDeviceMetricsOverride", **size)
        scheme = {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}
        self._call("Emulation.setEmulatedMedia", features=[scheme])

    def open(self, path: Path) -> None:
        """Load a file."""
        self._call("Page.navigate", url=path.resolve().as_uri())
        self.wait("document.readyState === 'complete' && location.protocol === 'file:'")

    def value(self, expression: str) -> Any:
        """The value of a JavaScript expression."""
        found = self._call("Runtime.evaluate", expression=expression, returnByValue=True)
        assert "exceptionDetails" not in found, found
        return found["result"].get("value")

    def wait(self, expression: str) -> None:
        """Wait until a JavaScript expression is true."""
        self.until(lambda: bool(self.value(expression)), expression)

    def until(self, condition: Callable[[], bool], what: str) -> None:
        """Wait until a condition holds."""
        end = time.monotonic() + PATIENCE
        while not condition():
            assert time.monotonic() < end, f"{what}: not within {PATIENCE:g} s; errors: {self.errors}"
            time.sleep(0.2)

    def picture(self, selector: str) -> NDArray[np.uint8]:
        """What an element, scrolled into view, looks like (height, width, 3), RGB."""
        self.value(f"document.querySelector({selector!r}).scrollIntoView({{block: 'center'}})")
        box = self.value(
            f"(b => ({{x: b.x + scrollX, y: b.y + scrollY, width: b.width, height: b.height}}))"
            f"(document.querySelector({selector!r}).getBoundingClientRect())"
        )
        found = self._call("Page.captureScreenshot", clip=box | {"scale": 1})
        data = np.frombuffer(base64.b64decode(found["data"]), np.uint8)
        image = cv2.imdecode(data, cv2.IMREAD_COLOR)
        assert image is not None
        return cv2.cvtColor(image, cv2.COLOR_BGR2RGB).astype(np.uint8)

    def _call(self, method: str, **parameters: Any) -> dict[str, Any]:
        self._number += 1
        self._socket.send(json.dumps({"id": self._number, "method": method, "params": parameters}))
        while True:
            message = json.loads(self._socket.recv(PATIENCE))
            if message.get("id") == self._number:
                assert "error" not in message, f"{method}: {message}"
                return message["result"]
            self._note(message)

    def _note(self, message: dict[str, Any]) -> None:
        found = message.get("params", {})
        if message["method"] == "Network.requestWillBeSent":
            self.requests.append(found["request"]["url"])
        elif message["method"] == "Runtime.exceptionThrown":
            self.errors.append(str(found["exceptionDetails"].get("exception", found)))
        elif message["method"] == "Runtime.consoleAPICalled" and found["type"] in ("error", "assert"):
            self.errors.append(str(found["args"]))
        elif message["method"] == "Log.entryAdded" and found["entry"]["level"] == "error":
            self.errors.append(found["entry"]["text"])


@contextmanager
def opened(path: Path, width: int = 1000, height: int = 700, dark: bool = False) -> Iterator[Page]:
    """A file in a new browser, which has a profile of its own and ends with the block."""
    assert CHROMIUM is not None
    root = ("--no-sandbox",) if os.geteuid() == 0 else ()
    with TemporaryDirectory(ignore_cleanup_errors=True) as profile:
        command = [CHROMIUM, *FLAGS, *root, f"--user-data-dir={profile}", "about:blank"]
        browser = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        try:
            with connect(_page_address(browser, Path(profile)), max_size=None, proxy=None) as socket:
                page = Page(socket, width, height, dark)
                page.open(path)
                yield page
        finally:
            browser.kill()
            browser.wait()


def _page_address(browser: subprocess.Popen[bytes], profile: Path) -> str:
    """Of the first page's socket, once the browser listens (on the loopback interface, at a port that it chose)."""
    end, file = time.monotonic() + PATIENCE, profile / "DevToolsActivePort"
    while not (file.exists() and file.read_text().strip()):
        assert browser.poll() is None, f"{CHROMIUM} ended with status {browser.returncode}"
        assert time.monotonic() < end, f"{CHROMIUM} does not listen after {PATIENCE:g} s"
        time.sleep(0.1)
    port = file.read_text().split()[0]
    with urlopen(f"http://127.0.0.1:{port}/json/list") as answer:
        targets = json.load(answer)
    return next(t["webSocketDebuggerUrl"] for t in targets if t["type"] == "page")
