"""A file is written whole or not at all."""

from pathlib import Path

import pytest

from gpgrad_core.io.records.files import check_output, replacing
from tests.support.refusal import assert_refused


def test_a_file_is_replaced_when_the_block_has_succeeded(tmp_path: Path) -> None:
    path = tmp_path / "a.txt"
    with replacing(path) as unfinished:
        unfinished.write_text("old")
        assert unfinished.suffix == path.suffix
        assert not path.exists()
    assert path.read_text() == "old"

    def fail() -> None:
        with replacing(path) as unfinished:
            unfinished.write_text("half")
            raise RuntimeError("full disk")

    with pytest.raises(RuntimeError, match="full disk"):
        fail()
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_where_no_file_can_be_is_said(tmp_path: Path) -> None:
    for path, endings, rule in (
        (tmp_path / "missing" / "a.json", (), "missing; make it first"),
        (tmp_path, (), "is a folder"),
        (tmp_path / "a.txt", (".npz", ".png"), "a.txt: the ending must be one of .npz, .png"),
    ):
        assert_refused(lambda: check_output(path, endings), rule)  # noqa: B023
    assert check_output(tmp_path / "a.PNG", (".png",)) == tmp_path / "a.PNG"
