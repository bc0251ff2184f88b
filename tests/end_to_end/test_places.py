"""Where little may be written: no home, the home of another, what another has kept."""

import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from app.cli import view
from gpgrad_core.run.store import Store
from tests.end_to_end.process import ROOT, Finished, environment, gpgrad, start
from tests.end_to_end.test_slam import write_by_hand

pwd = pytest.importorskip("pwd", reason="this system has no such list of users")
FOLDERS = ("HOME", "XDG_CACHE_HOME", "XDG_CONFIG_HOME", "MPLCONFIGDIR")


def as_others() -> tuple[str, ...]:
    """What starts a program to which permissions apply, as they do not to the superuser."""
    if os.geteuid() != 0:
        return ()
    if sys.platform != "linux" or shutil.which("setpriv") is None:
        pytest.skip("the superuser may write anywhere, and setpriv is not installed")
    return ("setpriv", "--bounding-set=-dac_override,-dac_read_search")


@pytest.fixture
def home(tmp_path: Path) -> Iterator[Path]:
    """A home that nobody may look into."""
    folder = tmp_path / "home"
    folder.mkdir()
    folder.chmod(0)
    yield folder
    folder.chmod(0o700)


def in_home(home: Path | None) -> dict[str, str]:
    kept = {name: value for name, value in environment().items() if name not in FOLDERS}
    return kept if home is None else kept | {"HOME": str(home)}


def run_in(home: Path, *arguments: str | Path) -> Finished:
    with start(
        *arguments,
        before=as_others(),
        env=in_home(home),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    ) as process:
        out, err = process.communicate(timeout=180)
    return Finished(process.returncode, out, err)


def test_a_user_that_the_system_has_never_heard_of(
    traverse: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As in a container: without a home, platformdirs raises a RuntimeError."""

    def nobody(_: int) -> None:
        raise KeyError

    for name in FOLDERS:
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(pwd, "getpwuid", nobody)
    finished = gpgrad("detect", traverse, "--out", tmp_path / "closures.json")
    assert (finished.code, finished.err) == (0, "")
    assert view.users_folder() is None


@pytest.mark.slow
def test_the_home_of_another(traverse: Path, home: Path, tmp_path: Path) -> None:
    """As with ``sudo -u``: it was refused for the results that it could not keep."""
    finished = run_in(home, "detect", traverse, "--out", tmp_path / "closures.json")
    assert (finished.code, finished.err) == (0, "")


@pytest.mark.slow
def test_the_viewer_in_the_home_of_another(traverse: Path, home: Path) -> None:
    with start(
        *("view", traverse, "--port", "0", "--no-open"),
        before=as_others(),
        env=in_home(home),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    ) as process:
        assert process.stdout is not None
        opened = any("is open" in line for line in process.stdout)
        process.terminate()
        _, said = process.communicate(timeout=60)
    assert opened, said
    assert said == "gpgrad: terminated\n"


@pytest.mark.slow
def test_figures_without_a_home_to_write_to(traverse: Path, home: Path, tmp_path: Path) -> None:
    """matplotlib told the terminal about its cache, in two lines."""
    closures = write_by_hand(tmp_path / "closures.json", accepted=True)
    out = tmp_path / "map"
    finished = run_in(home, "slam", traverse, "--out", out, "--closures", closures, "--no-merge")
    assert (finished.code, finished.err) == (0, "")
    assert list(out.glob("*.png"))


def test_what_another_has_kept_is_used(tmp_path: Path) -> None:
    """It was not, once ten minutes had passed: the use could not be written down."""
    folder = tmp_path / "kept"
    assert Store(folder).put("key", 7)
    for path in (*folder.iterdir(), folder):
        path.chmod(0o555)
    program = (
        "import gpgrad_core.run.store as store\n"
        "from pathlib import Path\n"
        "store.FRESH = -1.0\n"
        f"kept = store.Store(Path({str(folder)!r}))\n"
        "print(kept.get('key'), kept.put('other', 8))"
    )
    command = [*as_others(), sys.executable, "-c", program]
    said = subprocess.run(command, capture_output=True, text=True, env=environment(), check=True)
    folder.chmod(0o755)
    assert said.stdout == "7 False\n"


def test_where_the_current_folder_is_gone(
    traverse: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It said "No such file or directory" and no name, or Open3D ended it."""
    gone = tmp_path / "gone"
    gone.mkdir()
    monkeypatch.chdir(gone)
    try:
        gone.rmdir()
    except OSError:
        pytest.skip("this system keeps the folder that a process is in")
    said = gpgrad("detect", traverse, "--out", tmp_path / "closures.json").refusal
    assert said == "the current folder is gone, or cannot be read; go to another"
    monkeypatch.chdir(ROOT)
