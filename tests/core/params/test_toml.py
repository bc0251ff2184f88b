"""TOML that may come from anybody: it is refused in a line and in no time, or read."""

import time

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gpgrad_core.errors import InputError
from gpgrad_core.params.toml import MOST_BYTES, MOST_DEPTH, load_toml_text


def test_what_people_write_is_read() -> None:
    text = """
    # [[[[ a comment, "not closed
    [map.noise]
    name = "a.b.c.d [[[ {{{"
    path = 'C:\\data'
    long = \"\"\"
    "quoted" ... \\" ....................................
    \"\"\"
    raw = '''
    ''[[[[ it's ....................................
    '''
    grid = [[1.5, 2], [3, {x = 1e5}]]
    """
    read = load_toml_text(text, "file")
    assert read["map"]["noise"]["grid"] == [[1.5, 2], [3, {"x": 1e5}]]  # type: ignore[index]
    assert load_toml_text(text.encode(), "file") == read


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (".".join("a" * 49_000) + " = 1", "nested more than 32"),  # froze every page for 17 s
        ("[" + ".".join("a" * 49_000) + "]", "nested more than 32"),
        ("x = {" + ".".join("a" * 40_000) + " = 1}", "nested more than 32"),
        ("x = " + "[" * 5000, "nested more than 32"),  # a RecursionError
        ("x = " + "[\n" * 5000 + "]" * 5000, "nested more than 32"),
        ("x = " + "{a=" * 5000, "nested more than 32"),
        ("x = " + "9" * 5000, "is not a TOML file"),  # Python refuses to read it
        ("x = " + "1." * 5000, "nested more than 32"),
        ("#" * (MOST_BYTES + 1), "is too large"),
        ("x = 1\0", "is not a TOML file"),
        ("what is this", "is not a TOML file"),
        (b"\xff\xfe", "not a text in UTF-8"),
        ("'''" * 30_000, "file: "),
        ('"\\' * 40_000, "file: "),
        ("x = '''" + "'" * 90_000, "file: "),
    ],
)
def test_what_would_cost_is_refused_at_once(text: str | bytes, words: str) -> None:
    start = time.process_time()
    with pytest.raises(InputError, match=words) as refused:
        load_toml_text(text, "file")
    assert time.process_time() - start < 1.0
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize("depth", [MOST_DEPTH, MOST_DEPTH + 1])
def test_the_bound_is_where_it_is_said_to_be(depth: int) -> None:
    for text in ("x = " + "[" * depth + "]" * depth, ".".join("a" * (depth + 1)) + " = 1"):
        if depth <= MOST_DEPTH:
            assert load_toml_text(text, "file")
        else:
            with pytest.raises(InputError, match="nested"):
                load_toml_text(text, "file")


@settings(max_examples=60)
@given(st.text(alphabet="ab.=[]{}\"'#\\\n, 1", max_size=60) | st.text(max_size=30))
def test_any_text_is_read_or_refused(text: str) -> None:
    try:
        load_toml_text(text, "file")
    except InputError:
        return
