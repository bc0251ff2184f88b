"""The command line without a process: what a process cannot easily be brought to."""

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import numpy as np
import pytest
import tyro
from typing_extensions import Doc

import app.cli.detect
import app.cli.inputs
import app.cli.view
from app.cli import FAILED, INTERRUPTED, run
from app.cli.flags import Given, parse
from app.viewer.session.session_file import Opened
from app.viewer.viewer import Opening
from gpgrad_core.io.folder import Outline
from gpgrad_core.mapping.gradient_map import MapParams
from gpgrad_core.params import Bounds
from gpgrad_core.run import Progress, silent
from gpgrad_core.run.memo import Memo
from gpgrad_core.types import Dataset, Submap

DATASET = Dataset(
    "crater",
    (Submap.from_points(np.random.default_rng(0).normal(size=(20, 3)), "000"),),
    preferred={"query": "000", "map": {"length_scale": 0.45}},
    notes=("000.ply: 1 of 21 rows is not finite and was dropped",),
)


class FakeStage:
    """Hears how far the opening of a dataset is, and shows nothing."""

    def __call__(self, _words: str) -> Progress:
        return silent

    def show(self, submap: Submap) -> None:
        assert submap.points.size


@dataclass
class FakeViewer:
    """Remembers how it was made and what became of it."""

    opening: Opening
    params: None
    host: str
    port: int
    source: str = ""
    sessions: str = "shared"
    permissions: object = None
    admission: object = None
    store: object = None
    memory: int | None = None
    on_full: object = None
    link: str = "http://127.0.0.1:8080"
    closed: bool = False
    opened: Opened | None = None

    def __post_init__(self) -> None:
        self.memory = self.memory or 1_000_000_000

    def run_forever(self) -> None:
        self.opened = self.opening(Memo(), FakeStage())
        raise KeyboardInterrupt

    def close(self) -> None:
        self.closed = True


@dataclass
class Stage:
    """A viewer and a browser that only look like it."""

    viewers: list[FakeViewer] = field(default_factory=list)
    pages: list[str] = field(default_factory=list)
    loaded: list[Path] = field(default_factory=list)


@pytest.fixture
def stage(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Stage:
    stage = Stage()

    def make(*arguments: object, **named: object) -> FakeViewer:
        stage.viewers.append(FakeViewer(*arguments, **named))  # type: ignore[arg-type]
        return stage.viewers[-1]

    def load(
        path: Path,
        progress: object,
        *,
        most_bytes: int | None,
        on_submap: Callable[[Submap], None],
    ) -> Dataset:
        del progress
        assert most_bytes is not None  # a dataset may be larger than the memory
        on_submap(DATASET.submaps[0])
        stage.loaded.append(path)
        return DATASET

    monkeypatch.setattr(app.cli.view, "Viewer", make)
    monkeypatch.setattr(app.cli.inputs, "load_dataset", load)
    (tmp_path / "demo").mkdir()
    monkeypatch.setattr(app.cli.view, "demo_path", lambda: tmp_path / "demo")
    monkeypatch.setattr(app.cli.view.webbrowser, "open", stage.pages.append)
    return stage


def test_view_opens_the_demo_in_the_browser(
    stage: Stage, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(["view"]) == INTERRUPTED
    (viewer,) = stage.viewers
    assert stage.loaded == [tmp_path / "demo"]
    assert viewer.source == str(tmp_path / "demo")
    assert (viewer.host, viewer.port) == ("127.0.0.1", 8080)
    assert viewer.opened is not None
    assert viewer.opened.params.map == MapParams(length_scale=0.45)  # as the dataset prefers
    assert viewer.opened.used is not None
    assert viewer.opened.used.map.noise_std is not None
    assert stage.pages == ["http://127.0.0.1:8080"]
    assert viewer.closed
    said = capsys.readouterr()
    starts, address, memory, fitted, is_open = said.out.splitlines()
    assert starts == "The viewer starts …"
    assert address == "The viewer is at http://127.0.0.1:8080 (Ctrl-C ends)"
    assert fitted.startswith("crater: fitted: noise ")
    assert is_open == "crater is open"
    assert memory == "Memory: up to 1.0 GB (--memory changes it)"
    assert said.err.splitlines() == [f"gpgrad: {DATASET.notes[0]}", "gpgrad: interrupted"]


def test_view_takes_its_arguments(stage: Stage, tmp_path: Path) -> None:
    flags = "--no-open --host 0.0.0.0 --port 9000 --map.length-scale 0.2".split()  # noqa: SIM905
    run(["view", str(tmp_path), *flags])
    (viewer,) = stage.viewers
    assert stage.loaded == [tmp_path]
    assert (viewer.host, viewer.port) == ("0.0.0.0", 9000)
    assert viewer.opened is not None
    assert viewer.opened.params.map.length_scale == 0.2
    assert stage.pages == []


def test_an_error_of_the_system_is_one_line_too(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def fail(path: Path) -> Outline:
        raise PermissionError(13, "Permission denied", str(path))

    monkeypatch.setattr(app.cli.detect, "outline_dataset", fail)
    assert run(["detect", "secret", "--out", str(tmp_path / "a.json")]) == FAILED
    assert capsys.readouterr().err == "gpgrad: secret: Permission denied\n"


def test_a_mistake_of_ours_is_not_hidden(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    def fail(path: Path) -> Outline:
        raise ZeroDivisionError(f"loading {path}")

    monkeypatch.setattr(app.cli.detect, "outline_dataset", fail)
    with pytest.raises(ZeroDivisionError):
        run(["detect", "here", "--out", str(tmp_path / "a.json")])


def test_help_tells_the_unit_and_the_range_of_bounds(capsys: pytest.CaptureFixture[str]) -> None:
    @dataclass(frozen=True)
    class Params:
        width: Annotated[float, Bounds(0.5, 20_000, 0.5, "m"), Doc("How wide.")] = 2.0

    @dataclass(frozen=True)
    class Verb:
        params: Annotated[Given[Params], tyro.conf.arg(name="")] = Given(Params)

    with pytest.raises(SystemExit, match="0"):
        parse(Verb, "verb", ["--help"], "Does it.")
    said = " ".join(capsys.readouterr().out.replace("│", " ").split())
    assert "--width FLOAT How wide. Range: 0.5 to 20,000 m. (default: 2.0)" in said
