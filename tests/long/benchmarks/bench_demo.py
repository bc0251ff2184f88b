# ruff: noqa: T201 - what was measured is printed
"""How soon ``gpgrad demo`` shows something: ``python -m tests.long.benchmarks.bench_demo``.

A browser runs already, as on a desk. It goes to the page as soon as that is served, and looks at it
four times a second. Printed are the seconds from the start of the command to the page, to the first
picture of ground, and to the first closure of a loop on the time line. ``--command`` measures
another installation, and ``--pictures FOLDER`` keeps what was seen.
"""

import argparse
import contextlib
import os
import shlex
import signal
import socket
import subprocess
import sys
import time
import urllib.request
from pathlib import Path
from typing import Any

from playwright.sync_api import Browser, Page

from tests.browser.chromium import decode, find_chromium, is_blank, launch

LOOK_EVERY = 0.25
LONGEST = 300.0
"""After so long it is given up [s]."""


def main() -> int:
    """Measure."""
    parser = argparse.ArgumentParser(prog="python -m tests.long.benchmarks.bench_demo")
    parser.add_argument("--command", default=shlex.join([sys.executable, "-m", "app", "demo"]))
    parser.add_argument("--runs", type=int, default=3)
    parser.add_argument("--pictures", type=Path, help="a folder for what was seen")
    asked = parser.parse_args()
    executable = find_chromium()
    if executable is None:
        print("no Chromium found; name one in GPGRAD_CHROMIUM")
        return 2
    if asked.pictures is not None:
        asked.pictures.mkdir(parents=True, exist_ok=True)
    print("| run | page served [s] | first picture [s] | loop closed [s] |\n|---|---|---|---|")
    with launch(executable) as browser:
        for run in range(asked.runs):
            times = measure(shlex.split(asked.command), browser, asked.pictures)
            print(f"| {run} | " + " | ".join(f"{seconds:.1f}" for seconds in times) + " |")
    return 0


def measure(
    command: list[str], browser: Browser, folder: Path | None
) -> tuple[float, float, float]:
    """Run the command once; return the three times [s]."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    url = f"http://127.0.0.1:{port}"
    page = browser.new_page(viewport={"width": 1440, "height": 900})
    start = time.monotonic()
    viewer = subprocess.Popen(
        [*command, "--no-open", "--port", str(port)],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )

    def since() -> float:
        seconds = time.monotonic() - start
        if seconds > LONGEST or viewer.poll() is not None:
            raise TimeoutError(f"{shlex.join(command)}: nothing came in {seconds:.0f} s")
        return seconds

    try:
        while not is_served(url):
            time.sleep(0.02)
            since()
        served = since()
        page.goto(url)
        drawn = 0.0
        for number in range(round(LONGEST / LOOK_EVERY)):
            if not drawn and shows_ground(page):
                drawn = since()
                keep(page, folder, f"first_{number}")
            if page.locator("[data-testid=timeline] [data-kind=closure]").count():
                break
            since()
            page.wait_for_timeout(1000 * LOOK_EVERY)
        closed = since()
        page.wait_for_timeout(3000)
        keep(page, folder, "closed")
        return served, drawn, closed
    finally:
        page.close()
        os.killpg(viewer.pid, signal.SIGTERM)
        viewer.wait()


def is_served(url: str) -> bool:
    """Say whether there is a page."""
    with contextlib.suppress(OSError), urllib.request.urlopen(url, timeout=1) as answer:
        return bool(answer.status == 200)
    return False


def shows_ground(page: Page) -> bool:
    """Say whether the middle of the canvas has more than a background."""
    middle: Any = {"x": 400, "y": 150, "width": 600, "height": 500}
    return not is_blank(decode(page.screenshot(clip=middle)))


def keep(page: Page, folder: Path | None, name: str) -> None:
    """Write a picture, if there is a folder for it."""
    if folder is not None:
        page.screenshot(path=folder / f"{name}.png")


if __name__ == "__main__":
    sys.exit(main())
