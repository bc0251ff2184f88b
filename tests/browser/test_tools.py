"""The tools beside the sliders, and the report."""

from pathlib import Path
from typing import Any

import pytest

from app.viewer.server.host import pages

pytestmark = [pytest.mark.browser, pytest.mark.slow]


def test_sliders_have_names_and_their_arrows_leave_the_camera(page: Any) -> None:
    thumbs = page.page.locator(".mantine-Slider-thumb")
    page.wait(lambda: bool(thumbs.last.get_attribute("aria-label")), "names of the sliders")
    names = [thumbs.nth(k).get_attribute("aria-label") for k in range(thumbs.count())]
    assert all(names)
    assert "Length-scale [m]" in names
    (client,) = pages(page.viewer.sessions[0].desk.host).values()
    before, value = client.camera.position.copy(), page.value("Minimum score")
    page.thumb("Minimum score").focus()
    for _ in range(4):
        page.page.keyboard.press("ArrowRight", delay=120)
    page.wait(lambda: page.value("Minimum score") != value, "another threshold")
    page.settle()
    assert client.camera.position == pytest.approx(before, abs=1e-6)


def test_a_report_opens_and_a_link_is_copied(page: Any, browser: Any, tmp_path: Path) -> None:
    page.tab("Save")
    with page.page.expect_download() as download:
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
    page.page.context.grant_permissions(["clipboard-read", "clipboard-write"])
    for button, words in (("Copy command", "gpgrad detect"), ("Copy link", page.page.url[:20])):
        page.page.get_by_role("button", name=button).click()
        page.page.get_by_role("button", name="Copied").first.wait_for()
        page.wait(
            lambda words=words: page.page.evaluate("navigator.clipboard.readText()").startswith(
                words
            ),
            words,
        )
