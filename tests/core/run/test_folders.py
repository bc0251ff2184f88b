"""A folder appears whole or not at all, and what a killed process left is removed."""

import errno
import os
import tempfile
from contextlib import suppress
from pathlib import Path
from unittest.mock import Mock

import pytest

from gpgrad_core.io.folder import load_dataset
from gpgrad_core.run import folders
from gpgrad_core.run.folders import MARK, NameLock, TemporaryFolder, naming, staging, whole_folder
from gpgrad_core.run.store import Store
from tests.support.refusal import assert_refused

pytest.importorskip("fcntl", reason="no locks on this system")


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def texts(folder: Path) -> dict[str, str]:
    return {path.name: path.read_text() for path in folder.iterdir() if path.is_file()}


@pytest.fixture
def old(tmp_path: Path) -> Path:
    """A folder with files of a user and of an earlier run."""
    (tmp_path / "map").mkdir()
    for name in ("mine.txt", "cloud.ply", "report.json"):
        (tmp_path / "map" / name).write_text("old")
    return tmp_path / "map"


OLD = {"mine.txt": "old", "cloud.ply": "old", "report.json": "old"}


def write(place: Path, *new: str, error: BaseException | None = None) -> None:
    """Write files as a run does whose earlier files were a cloud and a report."""
    with whole_folder(place, earlier=["cloud.ply", "report.json"]) as folder:
        for name in new:
            (folder / name).write_text("new")
        assert not place.exists() or texts(place) == OLD
        if error is not None:
            raise error


def test_it_appears_in_one_step(tmp_path: Path) -> None:
    left = tmp_path / "new" / ".map.part" / "prepared"  # by a killed process
    left.mkdir(parents=True)
    (left / "half.ply").touch()
    (left.parent / MARK).write_text(".map.part")
    write(tmp_path / "new" / "map", "a.txt")
    assert names(tmp_path / "new") == ["map"]
    assert names(tmp_path / "new" / "map") == ["a.txt"]


@pytest.mark.parametrize("error", [KeyboardInterrupt(), OSError(28, "No space left on device")])
@pytest.mark.parametrize("there", [False, True])
def test_a_failure_leaves_what_was_there(
    tmp_path: Path, old: Path, error: BaseException, there: bool
) -> None:
    place = old if there else tmp_path / "new"
    with pytest.raises(type(error)):
        write(place, "report.json", error=error)
    assert names(tmp_path) == ["map"]
    assert texts(old) == OLD


def test_other_files_stay_and_an_interruption_between_two_moves_the_rest_first(
    old: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    moved: list[str] = []
    really = Path.replace

    def replace(self: Path, target: Path) -> Path:
        moved.append(self.name)
        if len(moved) == 2:
            raise KeyboardInterrupt
        return really(self, target)

    monkeypatch.setattr(Path, "replace", replace)
    with pytest.raises(KeyboardInterrupt):
        write(old, "a.txt", "b.txt", "report.json")
    assert texts(old) == {"mine.txt": "old", "a.txt": "new", "b.txt": "new", "report.json": "new"}
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
    assert (names(place), names(tmp_path)) == (["mine.txt"], ["data"])


def test_two_at_once_are_refused(tmp_path: Path) -> None:
    for _ in range(2):  # a lock ends with its block
        with whole_folder(tmp_path / "map", replace=True) as folder:
            (folder / "a.txt").touch()
            second = whole_folder(tmp_path / "map")
            assert_refused(second.__enter__, "map: another process is working on it; wait")
            assert names(folder) == ["a.txt"]
            assert (folder.parent / MARK).read_text() == folder.parent.name
        assert names(tmp_path / "map") == ["a.txt"]


@pytest.mark.parametrize("killed", ["before", "after"])
def test_a_kill_while_one_is_replaced_by_another(tmp_path: Path, killed: str) -> None:
    place, stage = tmp_path / "data", tmp_path / ".data.part"
    unfinished = stage / "prepared" if killed == "before" else place
    for folder, text in ((stage / "earlier", "old"), (unfinished, "new")):
        folder.mkdir(parents=True)
        (folder / "a.txt").write_text(text)
    (stage / MARK).write_text(stage.name)
    with staging(place):
        pass
    assert names(tmp_path) == ["data"]
    assert texts(place) == {"a.txt": "old" if killed == "before" else "new"}


def test_what_has_the_name_of_a_temporary_one_is_a_users_without_the_mark(tmp_path: Path) -> None:
    place, mine = tmp_path / "data", tmp_path / ".data.part"
    mine.mkdir()
    (mine / "notes.txt").write_text("mine")
    for way in (mine, tmp_path / ".link.part", tmp_path / ".file.part"):
        if way.name == ".link.part":
            way.symlink_to(mine)
        elif way.name == ".file.part":
            way.write_text("mine")
        output = tmp_path / way.stem.removeprefix(".")
        assert_refused(whole_folder(output).__enter__, "is in the way")
    assert_refused(lambda: NameLock(tmp_path / "file"), "is in the way")
    (mine / MARK).write_text(".other.part")  # a copy
    assert_refused(whole_folder(place).__enter__, "is in the way")
    assert texts(mine)["notes.txt"] == (tmp_path / ".file.part").read_text() == "mine"
    (tmp_path / ".data.replaced").mkdir()  # no name of gpgrad's
    (mine / MARK).write_text(mine.name)
    write(place, "a.txt")
    assert names(tmp_path) == [".data.replaced", ".file.part", ".link.part", "data"]


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


def test_a_mounted_folder_is_not_replaced(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    place = tmp_path / "out"
    place.mkdir()
    monkeypatch.setattr(Path, "is_mount", lambda path: path == place)
    number = place.stat().st_ino
    with whole_folder(place) as folder:
        (folder / "a.txt").touch()
        assert folder.parent.parent == place
    assert place.stat().st_ino == number
    assert names(place) == ["a.txt"]


def test_without_any_folder_for_temporary_files(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tempfile, "gettempdir", Mock(side_effect=FileNotFoundError(2, "none")))
    assert_refused(lambda: TemporaryFolder("x-"), "name one in the environment variable TMPDIR")


def test_a_path_deeper_than_python_can_follow_is_refused(tmp_path: Path) -> None:
    deep = tmp_path.joinpath(*["d"] * 1900)
    rule = "folders deep; 500 is the most"
    assert_refused(lambda: whole_folder(deep).__enter__(), rule)
    assert_refused(lambda: Store(deep), rule)
    assert_refused(lambda: load_dataset(deep), rule)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("unnamed", [None, ".out.part/prepared/a.npy"])
def test_a_full_disk_names_the_output_that_it_has_no_room_for(unnamed: str | None) -> None:
    full = OSError(errno.ENOSPC, "No space left on device", unnamed)
    with pytest.raises(OSError, match="No space"), naming(Path("folder")), naming(Path("record")):
        raise full
    assert full.filename == "record"


def test_a_full_disk_where_a_folder_begins_names_the_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    refusal = OSError(errno.ENOSPC, "No space left on device")
    monkeypatch.setattr(Path, "write_text", Mock(side_effect=refusal))
    with pytest.raises(OSError, match="No space"), whole_folder(tmp_path / "out"):
        raise AssertionError("nothing can be written")
    assert refusal.filename == str(tmp_path / "out")
