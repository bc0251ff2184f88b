"""Styles and scripts of the pages, as the browser's own parser takes them."""

from importlib.resources import files
from typing import Any

import pytest

from app.viewer import web
from app.viewer.web import fill_page_file

pytestmark = pytest.mark.browser
NAMES = sorted(file.name for file in files(web).iterdir())
# Gives the declarations that the browser leaves out, and the number of rules that it keeps.
PARSED = """text => {
    const sheet = new CSSStyleSheet(), wrong = [];
    sheet.replaceSync(text);
    for (const [, name, value] of text.matchAll(/[{;]\\s*([a-z-]+)\\s*:\\s*([^;{}]+);/g))
        if (!name.startsWith('--') && !CSS.supports(name, value.replace('!important', '')))
            wrong.push(`${name}: ${value}`);
    const count = rules => [...rules].reduce((n, rule) => n + 1 + count(rule.cssRules ?? []), 0);
    return [wrong, count(sheet.cssRules)];
}"""


@pytest.fixture(scope="module")
def blank(browser: Any) -> Any:
    page = browser.new_page()
    yield page
    page.close()


@pytest.mark.parametrize("name", [name for name in NAMES if name.endswith(".css")])
def test_the_browser_keeps_every_rule_of_a_style(blank: Any, name: str) -> None:
    text = fill_page_file(name, CHOSEN=1, SOLID="#123", SOLID_HOVER="#456", UUID="u", BOX="b")
    wrong, kept = blank.evaluate(PARSED, text)
    assert wrong == []
    assert kept == text.count("{")


@pytest.mark.parametrize("name", [name for name in NAMES if name.endswith(".js")])
def test_the_browser_parses_a_script(blank: Any, name: str) -> None:
    assert blank.evaluate("text => { new Function(text); return true; }", fill_page_file(name))
