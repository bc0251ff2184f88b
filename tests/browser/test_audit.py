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


def choose(page: Any, theme: str) -> None:
    page.page.evaluate("theme => gpgradTheme.choose(theme)", theme)
    page.rest()


def test_nothing_serious_is_found_in_the_light_and_in_the_dark(
    open_viewer: Callable[..., Any],
) -> None:
    page = open_viewer(size=SIZE)
    findings: dict[object, dict[str, list[str]]] = {}

    def look(where: str) -> None:
        for theme in ("light", "dark"):
            choose(page, theme)
            findings[where, theme] = audit(page.page)

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
    page.resize(*SIZE)
    page.thumb("Noise").hover()
    page.page.locator(".mantine-Tooltip-tooltip").wait_for()
    look("a tooltip")
    assert not any(findings.values()), findings
