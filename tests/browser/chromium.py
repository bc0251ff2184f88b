"""A headless Chromium that uses the viewer as a person does, with real mouse, keys and pixels."""

import io
import os
import shutil
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image
from playwright.sync_api import Browser, BrowserContext, Locator, Page, Playwright, sync_playwright

from app.viewer.features.modes import PANEL_WIDTH
from app.viewer.scene.cameras import place_on_screen, view_of
from app.viewer.server.host import pages
from app.viewer.session.state import ViewOptions
from app.viewer.viewer import Viewer
from gpgrad_core.arrays import NDArray
from gpgrad_core.detection import PipelineParams
from tests.support.waiting import PATIENCE

# Software rendering works without a graphics card. The browser must make no requests of its own.
FLAGS = [
    "--no-sandbox",
    "--use-angle=swiftshader",
    "--disable-gpu-compositing",  # faster for the page around the canvas, without a graphics card
    "--enable-unsafe-swiftshader",
    "--ignore-gpu-blocklist",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--no-first-run",
    "--disable-quic",
    "--disable-dev-shm-usage",
    "--mute-audio",
]
SIZE = (960, 600)
"""Of the window [pixels]."""
NO_NOTICE = """document.addEventListener('DOMContentLoaded', () => document.head.append(
    Object.assign(document.createElement('style'),
        {textContent: '.mantine-Notifications-root { display: none !important }'})))"""
"""The client warns that there is no graphics card, and the warning hides the picture."""
BETWEEN_INPUTS_MS = 80
"""Pause between two inputs [s]. It is longer than the 50 ms in which the client sends only one
change, the last."""

UNFOLD = """async node => {
    const heads = [];
    for (let at = node; at; at = at.parentElement)
        if (at.getAttribute('aria-hidden') === 'true' && at.previousElementSibling)
            heads.unshift(at.previousElementSibling);
    for (const head of heads) {  // the outermost first, as a person does
        head.click();
        await new Promise(done => setTimeout(done, 400));
    }
}"""
"""Opens the folders in which something lies."""
FIGURES = """() => {
    const texts = document.createTreeWalker(
        document.querySelector('[data-testid=figures]'), NodeFilter.SHOW_TEXT);
    const lines = [];
    while (texts.nextNode()) lines.push(texts.currentNode.data.trim());
    return lines.filter(line => line).join('\\n');
}"""

Pixels = NDArray[np.int16]


def find_chromium() -> str | None:
    """Find a Chromium: the one in GPGRAD_CHROMIUM, or one on the path."""
    named = os.environ.get("GPGRAD_CHROMIUM")
    if named:
        return named if Path(named).exists() else None
    names = ("chromium", "chromium-browser", "google-chrome")
    return next((found for name in names if (found := shutil.which(name))), None)


@contextmanager
def launch(executable: str, flags: tuple[str, ...] = ()) -> Iterator[Browser]:
    """Start the browser, with further flags, and end it."""
    with sync_playwright() as playwright, launch_in(playwright, executable, flags) as browser:
        yield browser


@contextmanager
def launch_in(
    playwright: Playwright, executable: str, flags: tuple[str, ...] = ()
) -> Iterator[Browser]:
    """Do the same where a driver runs already: a process can have one only."""
    browser = playwright.chromium.launch(
        executable_path=executable, headless=True, args=[*FLAGS, *flags]
    )
    try:
        yield browser
    finally:
        browser.close()


class ViewerPage:
    """One page of the viewer, which records its errors and its network requests."""

    viewer: Viewer
    """Whose page it is, where a test has started it in its own process."""

    shows = "verdict"  # what is on the page once it has been filled

    def __init__(
        self,
        browser: Browser | BrowserContext,
        url: str,
        *,
        size: tuple[int, int] = SIZE,
        script: str | None = None,
        pixel_ratio: float = 1.0,
    ) -> None:
        """Open the page and wait for the first verdict and picture.

        Args:
            browser: Which opens it.
            url: The viewer's address.
            size: Of the window [pixels]. On a phone, only the verdict is waited for.
            script: Run in the page before its own.
            pixel_ratio: Pixels of the canvas for one of the page, each way; software draws each.
        """
        self.url, self.pixel_ratio = url, pixel_ratio
        self.errors: list[str] = []
        self.outside: list[str] = []
        self.page: Page = browser.new_page()
        self.page.set_default_timeout(1000 * PATIENCE)
        self.resize(*size)
        self.page.add_init_script(NO_NOTICE)
        if script is not None:
            self.page.add_init_script(script)
        local = (url, url.replace("http", "ws"), "blob:", "data:")
        self.page.on("pageerror", lambda error: self.errors.append(str(error)))
        self.page.on(
            "request",
            lambda request: (
                None if request.url.startswith(local) else self.outside.append(request.url)
            ),
        )
        self.open()

    def open(self) -> None:
        """Go to the viewer, as a person does who comes or reloads the page."""
        # The pixel ratio is fixed, because the client lowers it while frames are slow.
        self.page.goto(f"{self.url}/?fixedDpr={self.pixel_ratio}")
        self.page.get_by_test_id(self.shows).wait_for()
        if self.page.viewport_size["width"] >= SIZE[0]:  # type: ignore[index]
            self.wait(lambda: not self.is_blank(), "a picture")
            self.settle()

    def resize(self, width: int, height: int) -> None:
        """Make the window so large [pixels]."""
        self.page.set_viewport_size({"width": width, "height": height})

    def begin_again(self, params: PipelineParams, size: tuple[int, int] = SIZE) -> None:
        """Go back to the pair, the parameters and the view that the demo opens with."""
        self.resize(*size)
        self.page.mouse.move(5, 5)
        self.key("Escape")
        self.press("Tune")
        self.tab("View")
        desk = self.viewer.sessions[0].desk
        desk.change(pair=("007", "001"), method="gradient", params=params, options=ViewOptions())
        self.settle()

    def check(self) -> None:
        """Tell whether the page had errors, or asked another server for anything."""
        assert self.errors == []
        assert self.outside == []

    def close(self) -> None:
        """Close the page."""
        self.page.close()

    def rest(self) -> None:
        """Wait until nothing of the panels moves or fades any more."""
        self.page.wait_for_function(
            "document.getAnimations().every(one => one.playState !== 'running'"
            " || one.effect.getComputedTiming().iterations === Infinity)"
        )

    def wait(self, condition: Callable[[], bool], what: str, timeout: float = PATIENCE) -> None:
        """Wait until a condition holds; fail with its description."""
        end = time.monotonic() + timeout
        while not condition():
            if time.monotonic() > end:
                raise AssertionError(f"waited {timeout:.0f} s for {what}")
            self.page.wait_for_timeout(100)

    # What the user sees.

    def verdict(self) -> str:
        """Read the whole verdict card, and the figures below it, which may be folded."""
        return f"{self.page.get_by_test_id('card').inner_text()}\n{self.page.evaluate(FIGURES)}"

    def accepted(self) -> bool:
        """Read the headline."""
        return self.page.get_by_test_id("verdict").inner_text() == "Loop closure"

    def status(self) -> str:
        """Read the status line."""
        return self.page.get_by_test_id("status").inner_text()

    def legend(self) -> str:
        """Read the legend."""
        return self.page.get_by_test_id("legend").inner_text()

    def picture(self) -> Pixels:
        """Take a picture of the 3D canvas between the panels (rows, columns, 3)."""
        canvas = self.page.locator("canvas").first.bounding_box()
        panels = self.panel_edges()
        assert canvas is not None
        clip: Any = {
            "x": panels[0],
            "y": canvas["y"],
            "width": panels[1] - panels[0],
            "height": canvas["height"],
        }
        return decode(self.page.screenshot(clip=clip))

    def panel_edges(self) -> tuple[float, float]:
        """Find the inner edges of the two panels [pixels]."""
        right = self.page.get_by_test_id("mode").bounding_box()
        assert right is not None
        return PANEL_WIDTH + 20, right["x"] - 20

    def is_blank(self) -> bool:
        """Tell whether nearly all of the canvas has one colour."""
        return is_blank(self.picture())

    def settle(self) -> Pixels:
        """Wait until the status is "up to date" and the picture stands still; return it."""
        self.wait(lambda: "Up to date" in self.status(), "an up-to-date picture")
        last = self.picture()
        for _ in range(100):
            self.page.wait_for_timeout(150)
            now = self.picture()
            if changed(last, now) == 0.0 and "Up to date" in self.status():
                return now
            last = now
        raise AssertionError("the picture never stood still")

    def map_spot(self) -> tuple[float, float]:
        """Find a place of the window where the map shows ground [pixels]."""
        self.page.wait_for_timeout(1500)  # until the server knows where the camera has come to
        session = self.viewer.sessions[0]
        (client,) = pages(session.desk.host).values()
        scene, canvas = session.world.scene, session.desk.canvases.of(client)
        assert scene.terrain is not None
        spot = scene.spot(len(scene.terrain.positions) // 2)
        x, y = place_on_screen(view_of(client), canvas, np.array([spot]))[0]
        box = self.page.locator("canvas").first.bounding_box()
        assert box is not None
        return box["x"] + float(x), box["y"] + float(y)

    # What the user does.

    def widget(self, label: str) -> Locator:
        """Find a widget by the beginning of its label."""
        text = self.page.locator("label").filter(has_text=label).first
        widget = self.page.locator(f'[id="{text.get_attribute("for")}"]')
        widget.evaluate(UNFOLD)
        return widget

    def thumb(self, label: str) -> Locator:
        """Find the thumb of a slider."""
        return self.widget(label).locator("[role=slider]")

    def value(self, label: str) -> float:
        """Read a slider's value."""
        return float(self.thumb(label).get_attribute("aria-valuenow") or "nan")

    def drag(self, label: str, pixels: int, steps: int = 4, pause_ms: int = 0) -> None:
        """Drag a slider's thumb with the mouse."""
        self.thumb(label).scroll_into_view_if_needed()
        box = self.thumb(label).bounding_box()
        assert box is not None
        x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
        self.page.mouse.move(x, y)
        self.page.mouse.down()
        for step in range(1, steps + 1):
            self.page.mouse.move(x + pixels * step / steps, y)
            if pause_ms:
                self.page.wait_for_timeout(pause_ms)
        self.page.wait_for_timeout(BETWEEN_INPUTS_MS)
        self.page.mouse.up()
        self.page.wait_for_timeout(BETWEEN_INPUTS_MS)

    def number_box(self, label: str) -> Locator:
        """Find the box beside a slider in which its value can be typed."""
        return self.widget(label).locator("xpath=..//input[not(@type='hidden')]").last

    def type_value(self, label: str, value: str) -> None:
        """Type a slider's value into its number box, and press Enter."""
        box = self.number_box(label)
        box.click()
        box.press("Control+a")
        box.press_sequentially(value, delay=BETWEEN_INPUTS_MS)
        box.press("Enter")
        self.page.wait_for_timeout(2 * BETWEEN_INPUTS_MS)

    def choose(self, label: str, option: str) -> None:
        """Choose from a dropdown."""
        self.widget(label).click()
        self.page.get_by_role("option", name=option, exact=True).click()
        self.page.wait_for_timeout(BETWEEN_INPUTS_MS)

    def pair(self) -> tuple[str, str]:
        """Read which submaps the strip over the canvas names: query and database."""
        return self.say("pair-query"), self.say("pair-database")

    def opacities(self) -> set[str]:
        """Read how solid the arrows of the strip over the canvas are."""
        script = "all => all.map(arrow => getComputedStyle(arrow).opacity)"
        return set(self.page.locator("[data-step]").evaluate_all(script))

    def choose_submap(self, role: str, name: str) -> None:
        """Choose a submap from the list of the strip over the canvas."""
        self.page.locator(f"[data-testid=pair-strip] button[data-role={role}]").click()
        self.page.get_by_role("combobox", name=f"Choose the {role}").fill(name)
        self.page.get_by_role("option", name=name).first.click()
        self.page.wait_for_timeout(BETWEEN_INPUTS_MS)

    def tick(self, label: str) -> None:
        """Press a checkbox."""
        self.widget(label).click()
        self.page.wait_for_timeout(BETWEEN_INPUTS_MS)

    def press(self, name: str) -> None:
        """Press a button."""
        folded = self.page.locator("[aria-hidden=true] button").filter(has_text=name)
        for button in folded.all():
            button.evaluate(UNFOLD)
        self.page.get_by_role("button", name=name, exact=True).click()
        self.page.wait_for_timeout(BETWEEN_INPUTS_MS)

    def tab(self, name: str) -> None:
        """Bring a tab of a panel to the front."""
        self.page.get_by_role("tab", name=name, exact=True).click()
        self.page.wait_for_timeout(BETWEEN_INPUTS_MS)

    def key(self, name: str) -> None:
        """Press a key while no text box has the focus."""
        self.page.evaluate("document.activeElement && document.activeElement.blur()")
        self.page.keyboard.press(name)
        self.page.wait_for_timeout(BETWEEN_INPUTS_MS)

    def shift_click(self, x: float, y: float) -> None:
        """Click a place of the window with Shift held."""
        self.page.keyboard.down("Shift")
        self.page.mouse.click(x, y)
        self.page.keyboard.up("Shift")
        self.page.wait_for_timeout(BETWEEN_INPUTS_MS)

    def say(self, test_id: str) -> str:
        """Read a part of a panel; empty if it does not exist."""
        script = "id => document.querySelector(`[data-testid=\"${id}\"]`)?.innerText ?? ''"
        return str(self.page.evaluate(script, test_id))


class MapPage(ViewerPage):
    """One page of a viewer that shows the map of a drive."""

    shows = "timeline"

    def __init__(
        self,
        browser: Browser | BrowserContext,
        viewer: Viewer,
        *,
        size: tuple[int, int] = SIZE,
        pixel_ratio: float = 1.0,
    ) -> None:
        """Open the page and wait for the ground."""
        self.viewer = viewer
        super().__init__(browser, viewer.url, size=size, pixel_ratio=pixel_ratio)

    def settle(self) -> Pixels:
        """Wait for the ground of the submaps: the map has no status line."""

        def is_drawn() -> bool:
            sessions = self.viewer.sessions  # there is none while the dataset is opened
            return bool(sessions) and sessions[0].world.is_drawn(0.0)

        self.wait(is_drawn, "the ground")
        self.page.wait_for_timeout(1000)
        return self.picture()


def decode(png: bytes) -> Pixels:
    """Decode a picture (rows, columns, 3)."""
    return np.asarray(Image.open(io.BytesIO(png)).convert("RGB")).astype(np.int16)


def is_blank(picture: Pixels) -> bool:
    """Tell whether nearly all of a picture has one colour."""
    return float((np.abs(picture - picture[0, 0]).max(axis=-1) > 20).mean()) < 0.02


def changed(before: Pixels, after: Pixels) -> float:
    """Compute the share of the pixels that clearly changed."""
    if before.shape != after.shape:
        return 1.0
    return float((np.abs(before - after).max(axis=-1) > 20).mean())
