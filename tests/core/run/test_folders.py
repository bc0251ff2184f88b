"""A folder appears whole or not at all, and what a killed process left is removed."""

import os
import tempfile
from contextlib import suppress
from pathlib import Path

import pytest

from gpgrad_core.errors import InputError
from gpgrad_core.io.folder import load_dataset
from gpgrad_core.run import folders
from gpgrad_core.run.folders import TemporaryFolder, alone, put_in_place, recover, whole_folder
from gpgrad_core.run.store import Store
from tests.support.refusal import assert_refused

pytest.importorskip("fcntl", reason="no locks on this system")


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def test_it_appears_in_one_step(tmp_path: Path) -> None:
    place = tmp_path / "new" / "map"
    with whole_folder(place) as folder:
        (folder / "a.txt").write_text("a")
        assert not place.exists()
    assert names(place) == ["a.txt"]
    assert names(tmp_path / "new") == ["map"]


@pytest.mark.parametrize("error", [KeyboardInterrupt, OSError(28, "No space left on device")])
@pytest.mark.parametrize("there", [False, True])
def test_a_failure_leaves_what_was_there(
    tmp_path: Path, error: type[BaseException] | OSError, there: bool
) -> None:
    place = tmp_path / "map"
    if there:
        place.mkdir()
        (place / "report.json").write_text("old")
    expected = OSError if isinstance(error, OSError) else error

    def fail() -> None:
        with whole_folder(place, earlier=["report.json"]) as folder:
            (folder / "report.json").write_text("half")
            raise error

    with pytest.raises(expected):
        fail()
    assert names(tmp_path) == (["map"] if there else [])
    assert not there or names(place) == ["report.json"]
    assert not there or (place / "report.json").read_text() == "old"


def test_other_files_stay_and_those_of_an_earlier_run_go(tmp_path: Path) -> None:
    place = tmp_path / "map"
    place.mkdir()
    for name in ("mine.txt", "cloud.ply", "report.json"):
        (place / name).write_text("old")
    with whole_folder(place, earlier=["cloud.ply", "report.json"]) as folder:
        (folder / "report.json").write_text("new")
        (folder / "graph.g2o").write_text("new")
        assert (place / "report.json").read_text() == "old"
    assert names(place) == ["graph.g2o", "mine.txt", "report.json"]
    assert (place / "report.json").read_text() == "new"
    assert (place / "mine.txt").read_text() == "old"


def test_an_interruption_between_two_files_moves_the_rest_first(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    place = tmp_path / "map"
    place.mkdir()
    (place / "report.json").write_text("old")
    moved: list[str] = []
    really = Path.replace

    def replace(self: Path, target: Path) -> Path:
        moved.append(self.name)
        if len(moved) == 2:
            raise KeyboardInterrupt
        return really(self, target)

    monkeypatch.setattr(Path, "replace", replace)

    def write() -> None:
        with whole_folder(place, earlier=["report.json"]) as folder:
            for name in ("a.txt", "b.txt", "report.json"):
                (folder / name).write_text("new")

    with pytest.raises(KeyboardInterrupt):
        write()
    assert names(place) == ["a.txt", "b.txt", "report.json"]
    assert {path.read_text() for path in place.iterdir()} == {"new"}
    assert moved[-1] == "report.json"


def test_what_came_meanwhile_is_not_replaced(tmp_path: Path) -> None:
    place = tmp_path / "data"

    def write() -> None:
        with whole_folder(place) as folder:
            (folder / "a.txt").write_text("a")
            place.mkdir()
            (place / "mine.txt").write_text("mine")

    with pytest.raises(OSError, match="not empty"):
        write()
    assert names(place) == ["mine.txt"]
    assert names(tmp_path) == ["data"]


def test_two_at_once_are_refused(tmp_path: Path) -> None:
    def second() -> None:
        with whole_folder(tmp_path / "map"):
            raise AssertionError

    with whole_folder(tmp_path / "map") as folder:
        (folder / "a.txt").touch()
        with pytest.raises(InputError, match="map: another process is working on it; wait"):
            second()
        assert names(folder) == ["a.txt"]
    assert names(tmp_path / "map") == ["a.txt"]


def test_what_a_killed_process_left_is_removed(tmp_path: Path) -> None:
    left = tmp_path / ".map.part"
    (left / "deep").mkdir(parents=True)
    (left / "deep" / "half.ply").touch()
    with whole_folder(tmp_path / "map") as folder:
        assert names(folder) == []
    assert names(tmp_path) == ["map"]


@pytest.mark.parametrize("killed", ["before", "after"])
def test_a_kill_while_one_is_replaced_by_another(tmp_path: Path, killed: str) -> None:
    place, unfinished = tmp_path / "data", tmp_path / ".data.part"
    for folder in (place, unfinished):
        folder.mkdir()
        (folder / "a.txt").write_text(folder.name)
    replaced = tmp_path / ".data.replaced"
    place.rename(replaced)
    if killed == "after":
        unfinished.rename(place)
    recover(place)
    assert not replaced.exists()
    assert (place / "a.txt").read_text() == ("data" if killed == "before" else ".data.part")


def test_one_is_replaced_by_another(tmp_path: Path) -> None:
    place, unfinished = tmp_path / "data", tmp_path / ".data.part"
    for folder in (place, unfinished):
        folder.mkdir()
        (folder / "a.txt").write_text(folder.name)
    with pytest.raises(OSError, match="not empty"):
        put_in_place(unfinished, place)
    put_in_place(unfinished, place, replace=True)
    assert names(tmp_path) == ["data"]
    assert (place / "a.txt").read_text() == ".data.part"


def test_a_lock_ends_with_its_block(tmp_path: Path) -> None:
    for _ in range(2):
        with alone(tmp_path / "folder"):
            pass


def test_temporary_folders_of_killed_processes_are_removed(tmp_path: Path) -> None:
    left, user, copied = (tmp_path / f"gpgrad-x-{name}" for name in ("left", "mine", "copied"))
    for folder in (left, user, copied):
        folder.mkdir()
        (folder / "a.bin").touch()
        os.utime(folder, (0, 0))
    (left / folders.MARK).write_text(left.name)
    (copied / folders.MARK).write_text(left.name)
    (tmp_path / "gpgrad-x-link").symlink_to(left)
    with (
        TemporaryFolder("gpgrad-x-", tmp_path) as first,
        TemporaryFolder("gpgrad-x-", tmp_path) as second,
    ):
        assert not left.exists()
        assert {Path(first).name, Path(second).name} < set(names(tmp_path))
    assert names(tmp_path) == ["gpgrad-x-copied", "gpgrad-x-link", "gpgrad-x-mine"]
    assert names(user) == names(copied)[1:] == ["a.bin"]


@pytest.mark.skipif(not hasattr(os, "getuid"), reason="this system has no owners of folders")
def test_temporary_folders_lie_in_one_of_the_user_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    with TemporaryFolder("gpgrad-x-") as folder:
        own = Path(folder).parent
        assert own.parent == tmp_path
        assert own.stat().st_mode & 0o777 == 0o700
    own.chmod(0o777)  # others may write there, so it is as good as any
    with TemporaryFolder("gpgrad-x-") as folder:
        assert Path(folder).parent == tmp_path


@pytest.mark.skipif(not Path("/proc/self/fd").exists(), reason="counts open files in /proc")
def test_of_a_temporary_folder_no_open_file_stays(tmp_path: Path) -> None:
    def held() -> list[str]:
        held_open: list[str] = []
        for link in Path("/proc/self/fd").iterdir():
            with suppress(OSError):  # the one that lists them
                held_open.append(str(link.readlink()))
        return held_open

    for _ in range(2):
        with TemporaryFolder("gpgrad-x-", tmp_path) as folder:
            assert folder in held()
    assert not [name for name in held() if str(tmp_path) in name]


def test_a_mounted_folder_is_filled_not_replaced(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    place = tmp_path / "out"
    place.mkdir()
    monkeypatch.setattr(Path, "is_mount", lambda path: path == place)
    number = place.stat().st_ino
    with whole_folder(place) as folder:
        (folder / "a.txt").touch()
        assert folder.parent == place
    assert place.stat().st_ino == number
    assert names(place) == ["a.txt"]


def test_without_any_folder_for_temporary_files(monkeypatch: pytest.MonkeyPatch) -> None:
    def find() -> str:
        raise FileNotFoundError(2, "No usable temporary directory found in ['/tmp']")

    monkeypatch.setattr(tempfile, "gettempdir", find)
    with pytest.raises(InputError, match="name one in the environment variable TMPDIR"):
        TemporaryFolder("gpgrad-x-")


def test_a_path_deeper_than_python_can_follow_is_refused(tmp_path: Path) -> None:
    deep = tmp_path.joinpath(*["d"] * 1900)
    rule = "folders deep; 500 is the most"
    assert_refused(lambda: whole_folder(deep).__enter__(), rule)
    assert_refused(lambda: Store(deep), rule)
    assert_refused(lambda: load_dataset(deep), rule)
    assert not list(tmp_path.iterdir())
