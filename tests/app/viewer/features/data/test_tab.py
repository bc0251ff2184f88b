import io
import zipfile
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import viser

from app.viewer.features.data.folders import recent_datasets
from app.viewer.features.data.tab import DataTab
from app.viewer.features.desk import Desk
from app.viewer.server.limits import Permissions
from app.viewer.session.session_file import Opened, SavedSession
from app.viewer.session.state import open_dataset
from gpgrad_core.detection import PipelineParams
from gpgrad_core.io.folder import write_dataset
from tests.support.desk import Recorder, make_desk, rests, uses
from tests.support.drive import make_drive, write_drive
from tests.support.synthetic import make_dataset
from tests.support.widgets import find, user_sets


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of two datasets."""
    root = tmp_path_factory.mktemp("data")
    for name in ("hills", "others"):
        write_dataset(make_dataset(num_points=60, name=name), root / name)
    return root


@pytest.fixture
def opened(recorder: Recorder) -> list[Opened]:
    return recorder.datasets


STATE = open_dataset(make_dataset(num_points=60), PipelineParams())
Make = Callable[..., DataTab]


@pytest.fixture
def make(server: viser.ViserServer, tmp_path: Path, recorder: Recorder) -> Iterator[Make]:
    desks: list[Desk] = []

    def start(**places: Any) -> DataTab:
        (tmp_path / "uploads").mkdir(exist_ok=True)
        given = Permissions(config=tmp_path / "config", uploads=tmp_path / "uploads")
        desk = make_desk(server, STATE, recorder, replace(given, **places))
        desks.append(desk)
        return desk.join(DataTab(desk))

    yield start
    for desk in desks:
        desk.close()
    assert list((tmp_path / "uploads").iterdir()) == []  # nothing stays


def said(opening: DataTab) -> str:
    return opening.work_bar.said


def upload(opening: DataTab, name: str, content: bytes) -> None:
    file: Any = viser.UploadedFile(name, content)
    uses(opening, "Upload clouds", file)


def zipped(folder: Path) -> bytes:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        for path in sorted(folder.rglob("*.*")):
            archive.write(path, path.relative_to(folder.parent))
    return buffer.getvalue()


def assert_no_place_is_told(message: str, tmp_path: Path) -> None:
    """Check that a message about an upload does not say where its files lie for a while."""
    assert str(tmp_path) not in message


def test_a_path_is_opened_and_remembered(
    make: Make, server: viser.ViserServer, data: Path, tmp_path: Path, opened: list[Opened]
) -> None:
    opening = make()
    user_sets(find(server, "Folder"), str(data / "hills"))
    uses(opening, "Open", "Load")
    assert (opened[0].dataset.name, opened[0].source) == ("hills", str(data / "hills"))
    assert recent_datasets(tmp_path / "config") == (str(data / "hills"),)
    uses(opening, "Recent", str(data / "hills"))
    assert len(opened) == 2
    user_sets(find(server, "Folder"), "  ")
    user_sets(find(server, "Open"), "Load")
    assert "Type the path of a dataset folder first." in said(opening)


def test_below_a_root_folders_are_browsed_and_nothing_else_is_opened(
    make: Make, server: viser.ViserServer, data: Path, opened: list[Opened]
) -> None:
    opening = make(root=data / "hills")
    assert "hills" in opening.place.content
    user_sets(find(server, "Browse"), "submaps/")
    assert find(server, "Browse").options == ("choose …", "↑ up", *SUBMAPS)
    uses(opening, "Browse", SUBMAPS[1])
    assert [submap.id for submap in opened[-1].dataset.submaps] == ["001"]
    user_sets(find(server, "Browse"), "↑ up")
    uses(opening, "Use this folder")
    assert opened[-1].dataset.name == "hills"
    for path in (str(data / "others"), "../others", "/etc", "/nowhere"):
        user_sets(find(server, "Folder"), path)
        uses(opening, "Open", "Load")
        assert "may open nothing else" in said(opening)
    opening.restore(SavedSession(dataset=data / "others"))
    assert rests(opening)
    assert "may open nothing else" in said(opening)
    assert len(opened) == 2


SUBMAPS = ("000.ply", "001.ply", "002.ply", "003.ply")


@pytest.mark.slow
def test_a_zipped_dataset_is_uploaded(
    make: Make, data: Path, tmp_path: Path, opened: list[Opened]
) -> None:
    opening = make()
    upload(opening, "my hills.zip", zipped(data / "hills"))
    assert opened[0].dataset.name == "hills"
    assert len(opened[0].dataset.submaps) == 4
    assert Path(opened[0].source).is_relative_to(tmp_path / "uploads")
    assert recent_datasets(tmp_path / "config") == ()  # it will be gone
    uses(opening, "Open", "Load demo")
    assert not Path(opened[0].source).exists()  # it is no longer open
    upload(opening, "broken.zip", b"PK\x03\x04")
    assert "broken.zip: is not a complete zip archive" in said(opening)
    assert_no_place_is_told(said(opening), tmp_path)
    broken = io.BytesIO()
    with zipfile.ZipFile(broken, "w") as archive:
        archive.writestr("hills/submaps/000.ply", b"ply\nbroken")
        archive.writestr("hills/dataset.toml", b"")
    upload(opening, "two hills.zip", broken.getvalue())
    assert "two hills.zip: submaps/000.ply: " in said(opening)
    assert_no_place_is_told(said(opening), tmp_path)


def test_clouds_gather_in_one_dataset(
    make: Make, data: Path, tmp_path: Path, opened: list[Opened]
) -> None:
    opening = make()
    clouds = data / "hills" / "submaps"
    upload(opening, "000.ply", (clouds / "000.ply").read_bytes())
    upload(opening, "001.ply", b"ply\nbroken")
    assert ">001.ply: " in said(opening)
    assert_no_place_is_told(said(opening), tmp_path)
    upload(opening, "C:\\some\\where\\001.ply", (clouds / "001.ply").read_bytes())
    assert [[submap.id for submap in dataset.dataset.submaps] for dataset in opened] == [
        ["000"],
        ["000", "001"],
    ]
    upload(opening, "001.ply", (clouds / "001.ply").read_bytes())
    assert "was uploaded before" in said(opening)
    upload(opening, "evil.exe", b"MZ")
    assert "neither a zipped dataset" in said(opening)
    assert len(opened) == 2


@pytest.mark.parametrize(
    ("name", "rule"),
    [
        ("a\0.ply", "control character"),
        ("a" * 300 + ".ply", "longer than 200 bytes"),
        ("a/" * 2000 + "\x1b.ply", "control character"),
        ("..", "outside of its folder"),
    ],
)
def test_names_that_no_file_can_have_are_refused(
    name: str, rule: str, make: Make, tmp_path: Path
) -> None:
    opening = make()
    upload(opening, name, b"ply\n")
    assert rule in said(opening)
    assert "\n" not in said(opening)
    assert not [file for file in tmp_path.rglob("*.ply") if "uploads" in file.parts]


def test_the_clouds_together_have_a_bound(make: Make, data: Path, opened: list[Opened]) -> None:
    cloud = (data / "hills" / "submaps" / "000.ply").read_bytes()
    opening = make(max_upload=len(cloud) // 4 + 1)  # eight times as much may lie there
    for number in range(3):
        upload(opening, f"{number:03}.ply", cloud)
    assert len(opened) == 2
    assert "together" in said(opening)


def test_a_file_that_was_not_taken_is_told(make: Make, opened: list[Opened]) -> None:
    opening = make()
    opening.refuse("big.ply: has 3 MB; up to 1 MB can be uploaded")
    assert "up to 1 MB can be uploaded" in said(opening)
    assert opened == []


def test_a_session_is_restored_or_refused(make: Make, data: Path, opened: list[Opened]) -> None:
    opening = make()
    opening.restore(SavedSession(dataset=data / "hills", query_id="002"))
    assert rests(opening)
    assert opened[0].saved is not None
    assert opened[0].saved.query_id == "002"
    opening.restore(SavedSession(dataset=data / "hills", query_id="999"))
    assert rests(opening)
    assert "no submap" in said(opening)
    assert len(opened) == 1


def test_a_recording_is_to_be_built_first(make: Make, tmp_path: Path, opened: list[Opened]) -> None:
    bag = tmp_path / "drive.bag"
    bag.write_bytes(b"#ROSBAG V2.0\n")
    tab = make()
    tab.open(str(bag))
    assert rests(tab)
    assert "build its submaps first" in said(tab)
    assert opened == []


def test_the_home_of_nobody_is_refused(make: Make, opened: list[Opened]) -> None:
    """It was a traceback in the terminal, and no word in the page."""
    tab = make()
    tab.open("~nobody-of-that-name/data")
    assert "~nobody-of-that-name: there is no such home folder." in said(tab)
    assert opened == []


def test_a_recording_is_built_where_pages_may_write(
    make: Make, server: viser.ViserServer, tmp_path: Path, opened: list[Opened]
) -> None:
    root = tmp_path / "root"
    root.mkdir()
    write_drive(root / "drive", make_drive(num_scans=12, points_a_scan=60))
    tab = make(root=root, writes=True)
    tab.open(str(root / "drive"))
    assert rests(tab)
    assert "drive: is a recording; build its submaps in the tab Data" in said(tab)
    assert find(server, "New folder").value == str(root / "drive-submaps")
    for elsewhere in (tmp_path / "elsewhere", root / "none" / "new", root / ".." / "new"):
        user_sets(find(server, "New folder"), str(elsewhere))
        uses(tab, "Build submaps")
        assert "may open nothing else" in building_said(tab)
        assert not elsewhere.exists()
    (root / "link").symlink_to(tmp_path / "config", target_is_directory=True)
    user_sets(find(server, "New folder"), str(root / "link"))
    uses(tab, "Build submaps")
    assert "may open nothing else" in building_said(tab)
    user_sets(find(server, "New folder"), str(root / "made"))
    user_sets(find(server, "Length"), 1.5)
    uses(tab, "Build submaps")
    assert rests(tab)
    assert "4 submaps of 12 scans" in building_said(tab)
    assert opened[-1].source == str(root / "made")
    assert len(opened[-1].dataset.submaps) == 4


def test_nothing_is_built_before_it_is_offered_or_outside_of_the_root(
    make: Make,
    server: viser.ViserServer,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A press of the hidden button built what lay in the current folder."""
    root, outside = tmp_path / "root", tmp_path / "outside"
    root.mkdir()
    write_drive(outside, make_drive(num_scans=12, points_a_scan=60))
    write_drive(root / "drive", make_drive(num_scans=12, points_a_scan=60))
    monkeypatch.chdir(outside)
    tab = make(root=root, writes=True)
    user_sets(find(server, "New folder"), "made")
    uses(tab, "Build submaps")
    assert not (root / "made").exists()
    tab.open(str(root / "drive"))
    assert rests(tab)
    (root / "drive").rename(root / "away")
    (root / "drive").symlink_to(outside, target_is_directory=True)  # after it was offered
    uses(tab, "Build submaps")
    assert "may open nothing else" in building_said(tab)
    assert {entry.name for entry in root.iterdir()} == {"away", "drive"}


@pytest.mark.parametrize("path", ["a" * 4000, "/" + "a/" * 1999, "~/" + "b" * 4000])
@pytest.mark.parametrize("rooted", [True, False])
def test_a_path_that_no_system_takes_is_refused_in_a_line(
    make: Make,
    server: viser.ViserServer,
    tmp_path: Path,
    caplog: pytest.LogCaptureFixture,
    path: str,
    rooted: bool,
) -> None:
    write_drive(tmp_path / "drive", make_drive(num_scans=12, points_a_scan=60))
    tab = make(root=tmp_path if rooted else None, writes=True)
    tab.open(path)
    assert rests(tab)
    words = "too long", "folders deep", "no such file or folder"
    assert any(text in said(tab) for text in words)
    tab.open(str(tmp_path / "drive"))
    assert rests(tab)
    user_sets(find(server, "New folder"), path)
    uses(tab, "Build submaps")
    assert "too long" in building_said(tab) or "no such f" in building_said(tab)
    assert "Unexpected" not in said(tab) + building_said(tab)
    assert not caplog.records


def test_a_refused_name_tells_no_place(make: Make, tmp_path: Path) -> None:
    tab = make()
    for name in ("a\u202eylp.ply", "b\u00a0c.npy"):
        upload(tab, name, b"no cloud")
        assert_no_place_is_told(said(tab), tmp_path)
        assert f">{name[0]}" in said(tab)
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w") as archive:
        archive.writestr("submaps/\u202e000.ply", b"ply\nbroken")
    upload(tab, "hills\u202e.zip", content.getvalue())
    assert_no_place_is_told(said(tab), tmp_path)


def building_said(tab: DataTab) -> str:
    assert tab._builder is not None
    return tab._builder.bar.said
