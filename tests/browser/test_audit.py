"""The page as the accessibility rules of axe-core see it, in the light and in the dark."""

from collections.abc import Callable
from typing import Any

import pytest

pytestmark = [pytest.mark.browser, pytest.mark.slow]
RULES = ("wcag2a", "wcag2aa", "wcag21a", "wcag21aa")
SIZE, PHONE, ZOOMED = (1280, 900), (390, 844), (640, 450)
"""Windows; the last is the first at 200 %."""
THEMES = "light", "dark"
CONTRAST = {"color-contrast": {"options": {"contrastRatio": {"large": {"expected": 4.5}}}}}
"""Large text is held to what small text is."""


def audit(page: Any) -> dict[str, list[str]]:
    """Run axe-core; gives what it finds, each with the parts of the page that have it."""
    from axe_playwright_python.sync_playwright import Axe  # noqa: PLC0415

    options: Any = {"resultTypes": ["violations"], "runOnly": list(RULES), "checks": CONTRAST}
    violations = Axe().run(page, options=options).response["violations"]
    return {rule["id"]: [node["html"][:160] for node in rule["nodes"]] for rule in violations}


def test_nothing_is_found_in_the_light_and_in_the_dark(open_viewer: Callable[..., Any]) -> None:
    page = open_viewer(size=SIZE)
    findings: dict[object, dict[str, list[str]]] = {}

    def look(where: str, act: Callable[[], object] = lambda: None, undo: str = "") -> None:
        """Act, look in both themes, and press a key that undoes the act."""
        act()
        page.page.wait_for_timeout(300)
        assert where == "Present" or page.viewer.wait_idle(120.0)  # that never rests
        for theme in THEMES:
            page.page.evaluate("theme => gpgradTheme.choose(theme)", theme)
            page.rest()
            findings[where, theme] = audit(page.page)
        if undo:
            page.page.keyboard.press(undo)
            page.page.wait_for_timeout(300)

    def choose_a_query() -> None:
        page.page.locator("[data-testid=pair-strip] button[data-role=query]").click()
        page.page.get_by_role("option", name="003").wait_for()

    def present() -> None:
        page.press("Present")
        page.page.get_by_test_id("lower-third").wait_for()

    def show_tooltip() -> None:
        page.thumb("Noise").hover()
        page.page.locator(".mantine-Tooltip-tooltip").wait_for()

    look("Demo", lambda: page.press("Demo"))
    look("Present", present, "Escape")
    look("Explore", lambda: page.press("Explore"))
    look("a card on the map", lambda: page.page.mouse.move(*page.map_spot()))
    look("the matrix", lambda: page.key("Shift+P"), "Shift+P")
    look("Tune", lambda: page.press("Tune"))
    look("A | B", lambda: page.key("0"), "Escape")
    look("commands", lambda: page.key("Control+k"), "Escape")
    for size in (SIZE, ZOOMED, PHONE):
        page.resize(*size)
        look(f"the list of submaps at {size}", choose_a_query, "Escape")
        for mode in ("Explore", "Tune"):
            look(f"{mode} at {size}", lambda mode=mode: page.press(mode))
    page.resize(*SIZE)
    look("a tooltip", show_tooltip)
    assert not any(findings.values()), findings
