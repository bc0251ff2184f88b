from pathlib import Path

import numpy as np
import pytest

from app.viewer.features.data.folders import MOST_RECENT as MOST
from app.viewer.features.data.folders import (
    check_inside,
    inside,
    list_folder,
    recent_datasets,
    remember_dataset,
)
from gpgrad_core.errors import InputError


@pytest.fixture
def root(tmp_path: Path) -> Path:
    root = tmp_path / "data"
    for name in ("etna", "moon"):
        (root / name / "submaps").mkdir(parents=True)
        np.save(root / name / "submaps" / "000.npy", np.zeros((4, 3)))
    (root / "one.ply").write_text("ply")
    (root / "notes.txt").write_text("no cloud")
    (root / ".hidden").mkdir()
    outside = tmp_path / "secret"
    outside.mkdir()
    np.save(outside / "000.npy", np.zeros((4, 3)))
    (root / "link").symlink_to(outside)
    (root / "loop").symlink_to(root)
    return root


def test_what_there_is_to_choose_is_listed_and_nothing_beyond(root: Path) -> None:
    listing = list_folder(root, Path())
    assert listing.entries == ("etna/", "loop/", "moon/", "one.ply")
    assert listing.is_dataset
    etna = list_folder(root, Path("etna"))
    assert (etna.folder, etna.entries, etna.is_dataset) == (Path("etna"), ("submaps/",), True)


@pytest.mark.parametrize(
    "path", ["..", "../secret", "/etc", "link", "link/000.npy", "etna/../../secret", "nowhere"]
)
def test_nothing_outside_is_opened(root: Path, path: str) -> None:
    with pytest.raises(InputError) as refused:
        inside(root, Path(path))
    assert str(refused.value) == (  # of all the same, so that nobody learns what exists elsewhere
        f"{path}: no such file or folder in {root}, and this viewer may open nothing else"
    )
    with pytest.raises(InputError):
        list_folder(root, Path(path))


def test_paths_inside_are_resolved(root: Path) -> None:
    assert inside(root, root / "etna") == (root / "etna").resolve()
    assert inside(root, Path("loop/moon")) == (root / "moon").resolve()


def test_a_dataset_whose_clouds_are_links_to_elsewhere_is_refused(root: Path) -> None:
    assert check_inside(root, Path("etna")) == (root / "etna").resolve()
    (root / "etna" / "submaps" / "001.npy").symlink_to(root.parent / "secret" / "000.npy")
    with pytest.raises(InputError, match="no such file or folder"):
        check_inside(root, Path("etna"))
    (root / "moon" / "images" / "000").mkdir(parents=True)
    (root / "moon" / "images" / "000" / "a.png").symlink_to("/etc/passwd")
    with pytest.raises(InputError, match="no such file or folder"):
        check_inside(root, Path("moon"))


def test_recent_datasets_are_the_last_ones_that_are_still_there(tmp_path: Path) -> None:
    config = tmp_path / "not" / "yet"
    assert recent_datasets(config) == ()
    folders = [tmp_path / str(number) for number in range(MOST + 3)]
    for folder in folders:
        folder.mkdir()
        remember_dataset(config, str(folder))
    newest = tuple(str(folder) for folder in reversed(folders))[:MOST]
    assert recent_datasets(config) == newest
    assert remember_dataset(config, newest[2])[:2] == (newest[2], newest[0])
    Path(newest[0]).rmdir()
    assert newest[0] not in recent_datasets(config)
    (config / "recent.json").write_text("[3, {}")
    assert recent_datasets(config) == ()


def test_a_list_not_written_is_logged(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    (tmp_path / "file").write_text("")
    assert remember_dataset(tmp_path / "file", str(tmp_path)) == (str(tmp_path),)
    assert "not saved" in caplog.text
