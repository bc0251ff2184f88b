"""What a person reads has the glossary's words, and none of those that it names as not used."""

import ast
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
GLOSSARY = ROOT / "assets/guide/glossary.md"
PAGES = (ROOT / "README.md", *sorted((ROOT / "assets/guide").glob("*.md")))
ROOMS = (ROOT / "gpgrad_core", ROOT / "app")
SCRIPTS = sorted(path for room in ROOMS for path in room.rglob("*.js"))
MODULES = sorted(path for room in ROOMS for path in room.rglob("*.py"))


@cache
def unused_words() -> re.Pattern[str]:
    """What finds each word, or its plural, of the glossary's table *Not used*, across lines."""
    rows = re.findall(r"^\| (.+?) \| .+ \|$", _unused_part(), re.MULTILINE)
    words = [word for row in rows[1:] for word in row.split(", ")]
    assert len(words) >= 10
    texts = "|".join(r"\s+".join(map(re.escape, word.split())) for word in words)
    return re.compile(rf"\b({texts})s?\b", re.IGNORECASE)


def _unused_part() -> str:
    return GLOSSARY.read_text().split("\n## Not used\n")[1]


def texts_of(source: str) -> Iterator[tuple[int, str]]:
    """The line and text of each string of a module that is no docstring, also within f-strings."""
    tree = ast.parse(source)
    alone = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in alone:
            yield node.lineno, node.value


@pytest.mark.parametrize("path", PAGES, ids=lambda path: path.name)
def test_pages_have_the_words_of_the_glossary(path: Path) -> None:
    text = path.read_text()
    if path == GLOSSARY:
        text = text.replace(_unused_part(), "")
    assert not [match[0] for match in unused_words().finditer(text)]


def test_messages_labels_and_help_have_the_words_of_the_glossary() -> None:
    bad = [
        f"{path.relative_to(ROOT)}:{line}: {match[0]}"
        for path in MODULES
        for line, text in texts_of(path.read_text())
        for match in unused_words().finditer(text)
    ]
    bad += [
        f"{path.relative_to(ROOT)}: {match[0]}"
        for path in SCRIPTS
        for match in unused_words().finditer(path.read_text())
    ]
    assert not bad


def test_a_word_that_is_not_used_is_found() -> None:
    source = '"""Ground truth."""\nraise ValueError(f"{1} has no ground truth")\n'
    assert [
        (line, match[0])
        for line, text in texts_of(source)
        for match in unused_words().finditer(text)
    ] == [(2, "ground truth")]
    assert unused_words().search("two length\nscales")
    assert not unused_words().search("a length-scale of the dataset")
