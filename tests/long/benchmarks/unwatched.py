"""A page of the viewer that is left alone while it is timed.

Playwright has every message that a page's socket receives copied to itself, megabytes a picture:
that takes the processors more than half as long as the page does. So it only opens the page, and
then lets go; the mouse is moved, and the page asked, over a bare connection to its debugger.
"""

import json
import re
import subprocess
import tempfile
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import count
from typing import Any, Literal

from playwright.sync_api import sync_playwright
from websockets.sync.client import ClientConnection, connect

from tests.browser.chromium import FLAGS, ViewerPage

SIZE = (960, 600)
"""Of the window [pixels]."""
AWAKE = (
    "--disable-background-timer-throttling",
    "--disable-backgrounding-occluded-windows",
    "--disable-renderer-backgrounding",
)
"""Nobody brings the window to the front."""
THUMB = """(() => {
  const label = [...document.querySelectorAll('label')].find(l => l.innerText.startsWith(%s));
  const thumb = document.getElementById(label.htmlFor).querySelector('[role=slider]');
  thumb.scrollIntoView({block: 'nearest'});
  const box = thumb.getBoundingClientRect();
  return [box.x + box.width / 2, box.y + box.height / 2];
})()"""
PRESS = "[...document.querySelectorAll('button')].find(b => b.innerText === %s).click()"


class UnwatchedPage:
    """An open page, asked no more than needed."""

    def __init__(self, connection: ClientConnection) -> None:
        """Take over a page whose debugger is connected."""
        self._connection = connection
        self._numbers = count(1)
        width, height = SIZE
        metrics = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": False}
        self._call("Emulation.setDeviceMetricsOverride", **metrics)

    def evaluate(self, script: str) -> Any:
        """Give the value of an expression in the page."""
        answer = self._call("Runtime.evaluate", expression=script, returnByValue=True)
        if "exceptionDetails" in answer:
            raise AssertionError(f"{script}: {answer['exceptionDetails']}")
        return answer["result"].get("value")

    def status(self) -> str:
        """Read the status line."""
        return str(self.evaluate("document.querySelector('[data-testid=status]').innerText"))

    def thumb(self, label: str) -> tuple[float, float]:
        """Find the middle of a slider's thumb [pixels]."""
        x, y = self.evaluate(THUMB % json.dumps(label))
        return float(x), float(y)

    def press(self, name: str) -> None:
        """Press a button."""
        self.evaluate(PRESS % json.dumps(name))

    def mouse(self, what: Literal["Moved", "Pressed", "Released"], x: float, y: float) -> None:
        """Move the mouse there, with the left button held, press the button or let it go."""
        held = 0 if what == "Released" else 1
        self._call(
            "Input.dispatchMouseEvent",
            type=f"mouse{what}",
            x=x,
            y=y,
            button="left",
            buttons=held,
            clickCount=1,
        )

    def _call(self, method: str, **params: object) -> dict[str, Any]:
        number = next(self._numbers)
        self._connection.send(json.dumps({"id": number, "method": method, "params": params}))
        while True:
            message = json.loads(self._connection.recv())
            if message.get("id") == number:
                return message["result"]


@contextmanager
def open_unwatched(executable: str, url: str, script: str) -> Iterator[UnwatchedPage]:
    """Open the viewer and leave it alone; end the browser after.

    Args:
        executable: Of Chromium.
        url: The viewer's address.
        script: Run in the page before its own.
    """
    with _start(executable) as debugger:
        with sync_playwright() as playwright:
            browser = playwright.chromium.connect_over_cdp(f"http://{debugger}")
            ViewerPage(browser.contexts[0], url, size=SIZE, script=script)
            browser.close()  # lets go of it only
        with urllib.request.urlopen(f"http://{debugger}/json") as answer:
            targets = json.load(answer)
        socket = next(
            target["webSocketDebuggerUrl"]
            for target in targets
            if target["type"] == "page" and target["url"].startswith(url)
        )
        with connect(socket, max_size=None) as connection:
            yield UnwatchedPage(connection)


@contextmanager
def _start(executable: str) -> Iterator[str]:
    """Start Chromium; give the address of its debugger."""
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as profile:
        process = subprocess.Popen(
            [
                executable,
                "--headless=new",
                "--remote-debugging-port=0",
                f"--user-data-dir={profile}",
                f"--window-size={SIZE[0]},{SIZE[1]}",
                *FLAGS,
                *AWAKE,
                "about:blank",
            ],
            stderr=subprocess.PIPE,
            text=True,
        )
        try:
            assert process.stderr is not None
            matches = (re.search(r"ws://([^/]+)/", line) for line in process.stderr)
            address = next((match.group(1) for match in matches if match), None)
            if address is None:
                raise AssertionError("Chromium ended before its debugger listened")
            yield address
        finally:
            process.terminate()
            process.wait()
