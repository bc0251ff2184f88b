"""The page as the accessibility rules of axe-core see it, in the light and in the dark."""

from collections.abc import Callable
from typing import Any

import pytest

pytestmark = [pytest.mark.browser, pytest.mark.slow]
MODES = ("Demo", "Explore", "Tune")
BAD = ("serious", "critical")
SIZE, PHONE = (1280, 900), (390, 844)


def audit(page: Any) -> dict[str, list[str]]:
    """Run axe-core; gives the serious findings, each with the parts of the page that have it."""
    from axe_playwright_python.sync_playwright import Axe  # noqa: PLC0415

    violations = Axe().run(page, options={"resultTypes": ["violations"]}).response["violations"]
    return {
        rule["id"]: [node["html"][:160] for node in rule["nodes"]]
        for rule in violations
        if rule["impact"] in BAD
    }


def is_dark(page: Any) -> bool:
    scheme = "document.documentElement.dataset.mantineColorScheme"
    return bool(page.page.evaluate(scheme) == "dark")


def darken(page: Any, *, dark: bool) -> None:
    """Make the system dark, or light, and wait until the page sees it."""
    scheme = "dark" if dark else "light"
    page.page.emulate_media(color_scheme=scheme)
    page.page.wait_for_function(f"matchMedia('(prefers-color-scheme: {scheme})').matches")


def test_nothing_serious_is_found_in_the_light_and_in_the_dark_of_the_system(
    open_viewer: Callable[..., Any],
) -> None:
    page = open_viewer(size=SIZE)
    findings: dict[object, dict[str, list[str]]] = {}

    def look(where: str) -> None:
        for dark in (False, True):
            darken(page, dark=dark)
            page.wait(lambda dark=dark: is_dark(page) == dark, "a page as the system is")
            page.rest()
            findings[where, dark] = audit(page.page)

    for mode in MODES:
        page.press(mode)
        assert page.viewer.wait_idle(120.0)
        look(mode)
    for size in (SIZE, PHONE):
        page.resize(*size)
        page.page.locator("[data-testid=pair-strip] button[data-role=query]").click()
        page.page.get_by_role("option", name="003").wait_for()
        look(f"the list of submaps at {size}")
        page.page.keyboard.press("Escape")
    look("a phone")
    assert not any(findings.values()), findings
    # A person chooses, and the system is not followed any more.
    page.resize(*SIZE)
    assert is_dark(page)
    page.tick("Dark")
    page.wait(lambda: not is_dark(page), "a light page")
    darken(page, dark=False)
    darken(page, dark=True)
    page.page.evaluate("new Promise(done => setTimeout(done))")  # what listens has heard it
    assert not is_dark(page)
