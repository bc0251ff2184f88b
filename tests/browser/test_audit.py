"""The page as the accessibility rules of axe-core see it, in the light and in the dark."""

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from tests.browser.chromium import ViewerPage

pytestmark = [pytest.mark.browser, pytest.mark.slow]
MODES = ("Tune", "Explore", "Demo")
BAD = ("serious", "critical")
SIZES = ((1280, 900), (390, 844))


def audit(page: Any) -> dict[str, list[str]]:
    """Run axe-core; gives the serious findings, each with the parts of the page that have it."""
    from axe_playwright_python.sync_playwright import Axe  # noqa: PLC0415

    violations = Axe().run(page, options={"resultTypes": ["violations"]}).response["violations"]
    return {
        rule["id"]: [node["html"][:160] for node in rule["nodes"]]
        for rule in violations
        if rule["impact"] in BAD
    }


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("dark", [False, True])
def test_nothing_serious_is_found(
    open_viewer: Callable[..., "ViewerPage"], size: tuple[int, int], dark: bool
) -> None:
    page = open_viewer(size=SIZES[0])
    if dark:
        page.page.goto(f"{page.viewer.url}/?fixedDpr=1&darkMode")  # type: ignore[attr-defined]
        page.page.get_by_test_id("verdict").wait_for()
        page.dismiss_notice()  # viser's own, which has a button without a name
    page.page.set_viewport_size({"width": size[0], "height": size[1]})
    findings: dict[str, dict[str, list[str]]] = {}
    for mode in MODES if size == SIZES[0] else MODES[:1]:
        if size == SIZES[0]:
            page.press(mode)
        assert page.viewer.wait_idle(120.0)  # type: ignore[attr-defined]
        page.page.wait_for_timeout(1000)
        findings[mode] = audit(page.page)
        if mode == "Tune":
            page.page.locator("[data-testid=pair-strip] button[data-role=query]").click()
            page.page.get_by_role("option", name="003").wait_for()
            findings["the list of submaps"] = audit(page.page)
            page.page.keyboard.press("Escape")
    assert not any(findings.values()), findings
