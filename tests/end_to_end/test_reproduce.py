"""`gpgrad reproduce`: the paper's figures, and the page that shows them."""

import html
import re
import shlex
import shutil
import xml.etree.ElementTree
from pathlib import Path

import cv2
import pytest

from tests.core.recordings.test_build import contents
from tests.end_to_end.process import Finished, gpgrad

# The paper's maps are fine: seconds for each run.
slow, nightly = pytest.mark.slow, pytest.mark.nightly
OF_ONE = {1, 3, 4, 10}
OF_ALL = {6, 8, 9}
NAME = "small_traverse"


@pytest.fixture(scope="module")
def cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("cache")


def reproduce(cache: Path, *arguments: str | Path) -> Finished:
    finished = gpgrad("reproduce", *arguments, "--cache", cache)
    assert finished.code == 0, finished.err
    return finished


@pytest.fixture(scope="module")
def whole(with_truth: Path, cache: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("out") / "figures"
    finished = reproduce(cache, with_truth, "--out", out, "--method", "paper", "chance", "cshot")
    assert finished.out == f"{out / 'index.html'}\n"
    (note,) = finished.err.splitlines()
    # Which submap is refused first depends on the threads.
    left_out = r"gpgrad: small traverse: cshot is left out: 00\d: cshot needs the colours"
    assert re.match(left_out, note)
    return out


def files(numbers: set[int]) -> set[str]:
    stems = {f"figure_{n}_{NAME}" if n in OF_ONE else f"figure_{n}" for n in numbers}
    return {f"{stem}{ending}" for stem in stems for ending in (".png", ".svg")} | {"index.html"}


def names(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir()}


@slow
def test_every_figure_is_there_in_both_formats_and_of_a_papers_width(whole: Path) -> None:
    assert names(whole) == files(OF_ONE | OF_ALL)
    for path in whole.glob("*.png"):
        picture = cv2.imread(str(path))
        assert picture.shape[1] in (1050, 2148)  # 3.5 and 7.16 inches of 300 pixels
        assert picture.std() > 10  # not blank
        assert (picture[0, 0] == 255).all()  # on white paper
    for path in whole.glob("*.svg"):
        root = xml.etree.ElementTree.parse(path).getroot()
        assert root.get("width") in ("252pt", "515.52pt")


@slow
def test_the_page_shows_every_figure_and_needs_nothing_else(whole: Path) -> None:
    page = (whole / "index.html").read_text(encoding="utf-8")
    linked = set(re.findall(r'(?:src|href)="([^"]+)"', page))
    assert linked == names(whole) - {"index.html"}
    assert "cshot is left out" in page
    assert "The method paper accepts the pair 003, 000: " in page
    assert "By the true poses this is right." in page
    assert re.search(r"<td>small traverse</td><td>paper</td><td>1</td><td>1.000", page)


@nightly
def test_the_commands_of_the_page_make_the_same_figures(
    whole: Path, cache: Path, tmp_path: Path
) -> None:
    page = (whole / "index.html").read_text(encoding="utf-8")
    commands = [
        shlex.split(html.unescape(command)) for command in re.findall(r"<pre>(.*?)</pre>", page)
    ]
    assert len(commands) == 1 + len(OF_ONE | OF_ALL)
    for command in commands[1:]:
        assert command[:2] == ["gpgrad", "reproduce"]
        number = int(command[command.index("--figure") + 1])
        out = tmp_path / str(number)
        command[command.index("--out") + 1] = str(out)
        reproduce(cache, *command[2:])
        assert names(out) == files({number})
        for name in names(out) - {"index.html"}:
            assert (out / name).read_bytes() == (whole / name).read_bytes()


@slow
def test_another_run_compares_nothing_and_replaces_what_was_there(
    with_truth: Path, whole: Path, cache: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object, **__: object) -> None:
        raise AssertionError("it compared again")

    monkeypatch.setattr("gpgrad_core.detection.pairs.Pairs.compare", fail)
    out = tmp_path / "figures"
    shutil.copytree(whole, out)
    (out / "figure_1_gone.png").touch()
    (out / "mine.txt").touch()
    arguments = (with_truth, "--out", out, "--method", "paper", "chance")
    assert "holds index.html of an earlier run" in gpgrad("reproduce", *arguments).refusal
    reproduce(cache, *arguments, "--overwrite")
    assert names(out) == names(whole) | {"mine.txt"}
    made, before = contents(out), contents(whole)
    same = {name for name in before if name not in ("index.html",)}
    assert {name: made[name] for name in same} == {name: before[name] for name in same}


@nightly
def test_without_truth_the_figures_that_need_it_are_left_out(
    traverse: Path, cache: Path, tmp_path: Path
) -> None:
    finished = reproduce(cache, traverse, "--out", tmp_path / "figures")
    assert names(tmp_path / "figures") == files(OF_ONE | {6})
    (note,) = finished.err.splitlines()
    assert "small traverse: not in Figs. 8 and 9: fewer than two submaps have a true pose" in note
    page = (tmp_path / "figures" / "index.html").read_text(encoding="utf-8")
    assert note.removeprefix("gpgrad: ") in html.unescape(page)
    assert "aligned by odometry" in page
    assert "By the true poses" not in page


@nightly
def test_without_poses_and_with_one_submap(traverse: Path, cache: Path, tmp_path: Path) -> None:
    bare = tmp_path / "bare"
    bare.mkdir()
    for name in ("000.xyz", "003.xyz"):
        shutil.copy(traverse / "submaps" / name, bare)
    finished = reproduce(cache, bare, "--out", tmp_path / "two")
    made = {path.stem for path in (tmp_path / "two").glob("*.png")}
    assert made == {"figure_1_bare", "figure_3_bare", "figure_4_bare"}
    assert "bare: Fig. 10 left out: the poses of the submaps are not known" in finished.err
    assert "bare: not in Fig. 6: fewer than two submaps have a pose" in finished.err
    page = (tmp_path / "two" / "index.html").read_text(encoding="utf-8")
    assert "aligned by the motion found" in page
    alone = bare / "000.xyz"
    finished = reproduce(cache, alone, "--out", tmp_path / "one")
    assert {path.stem for path in (tmp_path / "one").glob("*.png")} == {"figure_3_000"}
    assert "Figs. 1, 4 and 10 left out: one submap makes no pair" in finished.err


@nightly
def test_several_datasets_share_what_the_paper_has_of_all(
    with_truth: Path, traverse: Path, cache: Path, tmp_path: Path
) -> None:
    arguments = ("--figure", "4", "6", "9", "--method", "paper")
    out = tmp_path / "figures"
    finished = reproduce(cache, with_truth, traverse, "--out", out, *arguments)
    first, second = f"figure_4_{NAME}", f"figure_4_{NAME}_2"
    assert {path.stem for path in out.glob("*.png")} == {first, second, "figure_6", "figure_9"}
    assert "not in Fig. 9" in finished.err
