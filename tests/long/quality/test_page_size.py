"""How large the page of a dataset is, and whether a browser opens it without a network."""

import contextlib
import io
from pathlib import Path

import pytest

from app.cli import run
from tests.browser.chromium import find_chromium, launch

LARGEST = 20e6
"""Bytes of a page of 400 pairs, or of 300 submaps."""
LONG_ENOUGH = 120_000
"""Time in which the page must be drawn [ms]."""


def quietly(*arguments: str | Path) -> None:
    with contextlib.redirect_stdout(io.StringIO()):
        assert run([str(argument) for argument in arguments]) == 0


def look(page_file: Path, picture: Path) -> dict[str, int]:
    """Open a page without a network; take a picture, and count what it shows."""
    executable = find_chromium()
    if executable is None:
        pytest.skip("no Chromium was found")
    with launch(executable) as browser:
        context = browser.new_context(offline=True, viewport={"width": 1400, "height": 1000})
        page = context.new_page()
        asked: list[str] = []
        page.on("request", lambda request: asked.append(request.url))
        page.goto(page_file.as_uri())
        page.wait_for_selector("body[data-ready]", timeout=LONG_ENOUGH)
        page.wait_for_selector("#map[data-closures]", timeout=LONG_ENOUGH)
        page.screenshot(path=picture)
        shown = {
            "closures": int(page.get_attribute("#map", "data-closures") or 0),
            "faces": int(page.get_attribute("#pair", "data-faces") or 0),
        }
        assert asked == [page_file.as_uri()]
    return shown


def test_marsyard(real_data: Path, tmp_path: Path) -> None:
    quietly("evaluate", real_data / "marsyard2021", "--out", tmp_path / "report")
    page = tmp_path / "report" / "page.html"
    shown = look(page, tmp_path / "page.png")
    print(f"\nmarsyard2021: {page.stat().st_size / 1e6:.1f} MB, {shown}; see {tmp_path}/page.png")
    assert page.stat().st_size <= LARGEST
    assert shown["closures"] > 50
    assert shown["faces"] > 5000


def test_three_hundred_submaps(tmp_path: Path) -> None:
    dataset = tmp_path / "long"
    quietly("simulate", dataset, "--route", "roaming", "--num-submaps", "300")
    near = ("--search-radius", "15", "--no-merge")
    quietly("slam", dataset, "--out", tmp_path / "map", *near)
    page = tmp_path / "map" / "page.html"
    shown = look(page, tmp_path / "page.png")
    print(f"\n300 submaps: {page.stat().st_size / 1e6:.1f} MB, {shown}; see {tmp_path}/page.png")
    assert page.stat().st_size <= LARGEST
    assert shown["closures"] > 250
    assert shown["faces"] > 2000
