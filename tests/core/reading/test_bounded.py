"""Text, TOML, JSON and names from outside are bounded before anything is made of them."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from gpgrad_core.errors import LONGEST, InputError
from gpgrad_core.reading.paths import check_name, check_path
from gpgrad_core.reading.records import LARGEST_TOML, as_builtins, parse_json, parse_toml
from gpgrad_core.reading.text import parse_number, split_rows
from tests.support.refusal import assert_refused


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("'a'." * 20_000 + "a = 1", "line 1: has a key of more than 20 parts"),
        ('"a" . ' * 20_000 + "a = 1", "line 1: has a key of more than 20 parts"),
        ("x = " + "{a=" * 30_000, "line 1: is nested more than 20 deep"),
        ("x = 0x" + "f" * 90_000, "a number or a key of 90,000 digits"),
        ("x = 1e" + "9" * 90_000, "a number or a key of 90,002 digits"),
        ("x" * 90_000, "is not TOML"),
        ('"""' + '\\"' * 40_000, "is not TOML"),
        ("'" * 90_000, "is not TOML"),
        ("#" * (LARGEST_TOML + 1), "is larger than 1,000,000 bytes"),
    ],
    ids=lambda text: text[:12],
)
def test_no_toml_takes_long(text: str, said: str) -> None:
    """Of most of these the parser makes minutes or gigabytes: it must not see them."""
    assert_refused(lambda: parse_toml(text, "a.toml"), "a.toml", said)


def test_what_toml_may_hold() -> None:
    text = 'a.b."c.d.e" = [[1.5, 2.5], ["[[[[", \'{{{\']] # [[[[[[[[[[[[[[[[[[[[[[[[\n'
    text += f'x = """\n{"[" * 30}\n{"1." * 30}\n"""'
    text += "\n" + r"""w = ['C:\', "\\", "\"[[", "#" ] # '[[[ " """
    text += "\nv = ['''[''[''''', " + r'"""[\"""[["[""" ]'
    table = parse_toml("\ufeff" + text, "a.toml")
    assert table["a"] == {"b": {"c.d.e": [[1.5, 2.5], ["[[[[", "{{{"]]}}
    line = "a.toml, line 8: is nested more than 20 deep"
    assert_refused(lambda: parse_toml(f"{text}\ny = {'[' * 21}", "a.toml"), line)


def test_json_is_bounded_and_strict() -> None:
    assert parse_json('{"a": "[[[[\\"]]", "b": [1, {}]}', "a") == {"a": '[[[["]]', "b": [1, {}]}
    assert parse_json(r'{"\\": ["\\\"[[", "[\\"]}', "a") == {"\\": ['\\"[[', "[\\"]}
    assert_refused(lambda: parse_json("[" * 33 + "\\", "a"), "a", "nested")
    for text, said in {
        "[" * 33: "nested",
        "NaN": "not JSON",
        "[1, -Infinity]": "not JSON",
        '{"a": 1, "a": 1}': "'a' twice",
        "9" * 65: "65 digits",
        '"' + "\\": "not a JSON file",
        "\ud800": "not a JSON file",
    }.items():
        assert_refused(lambda text=text: parse_json(text, "a.json"), "a.json", said)


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("../a.ply", "outside"),
        ("/a.ply", "outside"),
        ("C:\\a.ply", "outside"),
        ("", "outside"),
        ("a\0.ply", "control character"),
        ("a\ud800.ply", "control character"),
        ("é" * 101, "longer than 200 bytes"),
        ("a/" * 2000 + "b", "2,001 folders deep"),
    ],
)
def test_names_that_no_file_is_made_of(name: str, said: str) -> None:
    with pytest.raises(InputError, match=said) as refusal:
        check_name(name)
    assert str(refusal.value).isprintable()
    assert len(str(refusal.value)) < 200


def test_names_that_are_fine_and_paths_that_the_system_cannot_be_asked_about() -> None:
    assert str(check_name("hills\\submaps/000 \u3000é.ply")) == "hills/submaps/000 \u3000é.ply"
    assert_refused(lambda: check_path("a\0b"), "a\\x00b", "zero byte")
    assert_refused(lambda: check_path("a" * 5000), "too long")


def test_every_message_is_one_printable_line_of_some_length() -> None:
    message = str(InputError("a\nb\x1b[31mc\t\udcff" + "x" * 10_000 + "end"))
    assert message.startswith("a b\\x1b[31mc \\xdcff")
    assert message.endswith("end")
    assert message.isprintable()
    assert len(message) <= LONGEST
    assert str(InputError(message)) == message


def test_only_plain_numbers_are_numbers() -> None:
    for word in ("1", "-.5", "1.e3", "+1E-5", "nan", "-inf"):
        assert parse_number(word) is not None
    for word in ("1_0", "\uff11\uff12", "0x1", "", " 1", "1e", ".", "infinity!", "1,5", "--1"):
        assert parse_number(word) is None


def test_a_row_is_split_at_commas_unless_they_are_decimal_ones(tmp_path: Path) -> None:
    path = tmp_path / "rows.txt"
    path.write_text("1,2, 3 # x\n# 4\n\n1,5 2,5\n")
    assert split_rows(path) == [
        (f"{path}, line 1", ["1", "2", "3"]),
        (f"{path}, line 4", ["1,5", "2,5"]),
    ]


def test_numbers_of_numpy_can_be_written_and_objects_of_unknown_kinds_cannot() -> None:
    given = {"a": np.arange(4.0).reshape(2, 2), "b": (np.int16(3), np.bool_(True))}
    assert as_builtins(given) == {"a": [[0.0, 1.0], [2.0, 3.0]], "b": (3, True)}
    with pytest.raises(TypeError, match="a SimpleNamespace cannot be written"):
        as_builtins([SimpleNamespace()])
