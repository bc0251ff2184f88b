"""A file is written whole or not at all."""

from pathlib import Path

import pytest

from gpgrad_core.errors import InputError
from gpgrad_core.io.records.files import check_output, replacing


def test_a_file_appears_when_the_block_has_succeeded(tmp_path: Path) -> None:
    path = tmp_path / "a.txt"
    with replacing(path) as unfinished:
        unfinished.write_text("new")
        assert unfinished.suffix == path.suffix
        assert not path.exists()
    assert path.read_text() == "new"
    assert list(tmp_path.iterdir()) == [path]


def test_a_failure_leaves_what_was_there_and_nothing_else(tmp_path: Path) -> None:
    path = tmp_path / "a.txt"
    path.write_text("old")

    def fail() -> None:
        with replacing(path) as unfinished:
            unfinished.write_text("half")
            raise RuntimeError("full disk")

    with pytest.raises(RuntimeError, match="full disk"):
        fail()
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_where_no_file_can_be_is_said(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"no folder .*missing; make it first"):
        check_output(tmp_path / "missing" / "a.json")
    with pytest.raises(InputError, match="is a folder"):
        check_output(tmp_path)
    with pytest.raises(InputError, match=r"a\.txt: the ending must be one of \.npz, \.png"):
        check_output(tmp_path / "a.txt", (".npz", ".png"))
    assert check_output(tmp_path / "a.PNG", (".png",)) == tmp_path / "a.PNG"
