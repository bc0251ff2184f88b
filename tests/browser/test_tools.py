"""The tools beside the sliders, the report, and a server that goes and comes back."""

import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from app.viewer.server.host import pages

if TYPE_CHECKING:
    from tests.browser.chromium import ViewerPage

pytestmark = [pytest.mark.browser, pytest.mark.slow]
Open = Callable[..., "ViewerPage"]


def test_sliders_have_names_and_their_arrows_leave_the_camera(open_viewer: Open) -> None:
    page = open_viewer()
    page.settle()
    thumbs = page.page.locator(".mantine-Slider-thumb")
    page.wait(lambda: bool(thumbs.last.get_attribute("aria-label")), "names of the sliders")
    names = [thumbs.nth(k).get_attribute("aria-label") for k in range(thumbs.count())]
    assert all(names)
    assert "Length-scale [m]" in names
    (client,) = pages(page.viewer.sessions[0].desk.host).values()  # type: ignore[attr-defined]
    before, value = client.camera.position.copy(), page.value("Minimum score")
    page.thumb("Minimum score").focus()
    for _ in range(4):
        page.page.keyboard.press("ArrowRight", delay=120)
    page.wait(lambda: page.value("Minimum score") != value, "another threshold")
    page.settle()
    assert client.camera.position == pytest.approx(before, abs=1e-6)


def test_a_report_opens_from_disk(open_viewer: Open, browser: Any, tmp_path: Path) -> None:
    page = open_viewer()
    page.settle()
    page.tab("Save")
    with page.page.expect_download(timeout=120_000) as download:
        page.press("Save report")
    path = tmp_path / "report.html"
    download.value.save_as(path)
    other = browser.new_page()
    requests: list[str] = []
    other.on("request", lambda request: requests.append(request.url))
    other.goto(path.as_uri())
    text = other.inner_text("body")
    assert "Loop closure" in text
    assert "gpgrad detect" in text
    link = other.get_attribute("a", "href")
    assert link is not None
    assert "#query=007&database=001" in link
    width = other.evaluate("document.querySelector('img').naturalWidth")
    assert width == 1320
    assert {url.split(":")[0] for url in requests} <= {"file", "data"}
    other.close()


def test_the_command_and_the_link_are_copied(open_viewer: Open) -> None:
    page = open_viewer()
    page.page.context.grant_permissions(["clipboard-read", "clipboard-write"])
    page.tab("Save")
    for button, words in (("Copy command", "gpgrad detect"), ("Copy link", page.page.url[:20])):
        page.page.get_by_role("button", name=button).click()
        page.page.get_by_role("button", name="Copied").first.wait_for()
        page.wait(
            lambda words=words: page.page.evaluate("navigator.clipboard.readText()").startswith(
                words
            ),
            words,
        )


def test_a_server_that_was_gone_gets_the_parameters_back(browser: Any) -> None:
    from tests.browser.chromium import ViewerPage  # noqa: PLC0415

    server, url = serve("0")
    page = ViewerPage(browser, url)
    try:
        page.settle()
        page.type_value("Minimum score", "4.5")
        page.choose("Layer", "elevation")
        page.settle()
        page.wait(lambda: "layer=elevation" in page.page.url, "the address of what is shown")
        stop(server)
        page.wait(lambda: "does not answer" in page.say("connection"), "a banner")
        server, again = serve(url.rpartition(":")[2])
        assert again == url
        page.wait(lambda: page.say("connection").startswith("Connected"), "the server again")
        page.wait(lambda: page.value("Minimum score") == 4.5, "the parameters")
        page.wait(lambda: page.legend().startswith("Elevation"), "the layer")
        assert page.errors == []
    finally:
        page.close()
        stop(server)


def stop(server: subprocess.Popen[str]) -> None:
    """End a viewer, as a person does; once is enough."""
    server.terminate()
    server.wait()
    assert server.stdout is not None
    server.stdout.close()


def serve(port: str) -> tuple[subprocess.Popen[str], str]:
    """Start a viewer of the demo as a process; gives it and its address."""
    words = ["-u", "-m", "app", "view", "--no-open", "--port", port]
    server = subprocess.Popen(
        [sys.executable, *words], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    )
    assert server.stdout is not None
    for line in server.stdout:
        address = re.search(r"http://[0-9.:]+", line)
        if address is not None:
            return server, address[0]
    raise AssertionError("the viewer does not start")


def test_pairs_are_decided_by_keys(open_viewer: Open) -> None:
    page = open_viewer()
    page.settle()
    page.tab("All pairs")
    page.press("Compare pairs")
    page.wait(lambda: bool(page.say("triage")), "the list", timeout=240.0)
    assert page.viewer.wait_idle(240.0)  # type: ignore[attr-defined]
    desk = page.viewer.sessions[0].desk  # type: ignore[attr-defined]
    pair = desk.shown_pair
    for key, accepted, said in (("x", False, "Refused by hand"), ("a", True, "Accepted by hand")):
        page.key(key)
        page.wait(lambda said=said: said in page.say("verdict"), said)
        assert desk.decisions.verdicts[pair] is accepted
    page.key("g")
    page.wait(lambda: desk.shown_pair != pair, "the next undecided pair")
    assert desk.shown_pair not in desk.decisions.verdicts


def test_the_flat_picture_is_drawn_for_who_has_it_in_view(open_viewer: Open) -> None:
    page = open_viewer()
    page.settle()
    (session,) = page.viewer.sessions  # type: ignore[attr-defined]
    image = session.inspect.matches.image
    assert not image.visible
    page.tab("Inspect")
    page.wait(lambda: image.visible, "the picture")
    before = image.image.copy()
    page.tab("View")
    page.wait(lambda: not session.inspect.seen_by, "nobody to look at it")
    page.drag("Variance mask", -20)
    page.settle()
    assert (image.image == before).all()
    page.tab("Inspect")
    page.wait(
        lambda: image.image.shape != before.shape or (image.image != before).any(), "a new one"
    )
