"""How the program ends: told to, killed, with a full disk; and what it refuses to write over."""

import errno
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from app.cli import run
from app.cli.terminal import exit_code
from gpgrad_core.io.records.files import replacing
from gpgrad_core.run.folders import TemporaryFolder, private_folder, whole_folder
from gpgrad_core.run.parallel import SOCKETS
from gpgrad_core.simulation.params import SimulationParams
from gpgrad_core.simulation.recording import simulate_recording
from tests.core.recordings.test_build import contents
from tests.end_to_end.process import (
    QUICK_MAP,
    ROOT,
    Finished,
    environment,
    gpgrad,
    interruptible,
    start,
)
from tests.end_to_end.test_simulate import TINY
from tests.end_to_end.test_slam import write_by_hand
from tests.long.kills.killing import running

linux = pytest.mark.skipif(sys.platform != "linux", reason="looks at signals and /proc")


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def wait_for(ready: Callable[[], object], seconds: float = 60.0) -> None:
    deadline = time.monotonic() + seconds
    while not ready():
        assert time.monotonic() < deadline, "it never came to that"
        time.sleep(0.01)


# Told to end, or killed.


@pytest.mark.slow
@linux
@pytest.mark.parametrize("kill", [signal.SIGTERM, signal.SIGKILL])
def test_simulate_scans_leaves_no_part_of_a_recording(tmp_path: Path, kill: int) -> None:
    """Killed, it left some of the scans with all of the poses, and build took them."""
    out, unfinished = tmp_path / "drive", tmp_path / ".drive.part"
    with start("simulate", out, "--scans", "5000", *TINY, stderr=subprocess.PIPE) as process:
        wait_for(lambda: len(list(unfinished.glob("prepared/scans/*.ply"))) > 3)
        process.send_signal(kill)
        _, said = process.communicate(timeout=60)
    if kill == signal.SIGKILL:
        assert names(tmp_path) == [".drive.part"]
        refused = gpgrad("build", unfinished, "--out", tmp_path / "data").refusal
        assert "is a recording that is not finished" in refused
        assert run(["simulate", str(out), "--scans", "3", *TINY]) == 0
        assert names(tmp_path) == ["drive"]  # what was left is gone
        return
    assert process.returncode == 143
    assert said.splitlines() == ["gpgrad: terminated"]
    assert names(tmp_path) == []


POOL = """
from gpgrad_core.run.parallel import WORTH_PROCESSES, run_jobs, workers
if __name__ == "__main__":
    with workers(2, WORTH_PROCESSES) as executor:
        run_jobs(work, [600.0] * 4, executor, lambda _: None)
"""


@pytest.mark.slow
@linux
def test_the_workers_of_a_killed_process_end(tmp_path: Path) -> None:
    """Four processes of a killed detect stayed for good."""
    short = Path(tempfile.mkdtemp(prefix="t-"))  # not where a socket's name would be too long
    script = tmp_path / "pool.py"
    script.write_text("from jobs import work\n" + POOL)
    (tmp_path / "jobs.py").write_text(
        "import time\nfrom pathlib import Path\n"
        "def work(seconds, progress):\n"
        f"    Path({str(tmp_path)!r}, f'begun-{{time.monotonic_ns()}}').touch()\n"
        "    time.sleep(seconds)\n"
    )
    with (
        interruptible(),
        subprocess.Popen(
            [sys.executable, str(script)],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            env=environment()
            | {"PYTHONPATH": f"{ROOT}{os.pathsep}{tmp_path}", "TMPDIR": str(short)},
            start_new_session=True,
        ) as process,
    ):
        wait_for(lambda: len(list(tmp_path.glob("begun-*"))) == 2)
        assert len(running(process.pid)) >= 3
        process.kill()
        assert process.wait(60) == -signal.SIGKILL
    wait_for(lambda: not running(process.pid), 30)
    assert len(list(short.glob(f"*/{SOCKETS}*/pymp-*/*"))) == 1
    TemporaryFolder(SOCKETS, private_folder(short)).cleanup()
    private_folder(short).rmdir()
    short.rmdir()  # what was left, a socket in a folder, is gone


@pytest.mark.slow
@linux
def test_the_viewer_takes_its_uploads_along(traverse: Path, tmp_path: Path) -> None:
    """Under SIGTERM it left them in the temporary folder."""
    with start(
        *("view", traverse, "--port", "0", "--no-open", "--config", tmp_path / "config"),
        env=environment() | {"TMPDIR": str(tmp_path)},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        start_new_session=True,
    ) as process:
        assert process.stdout is not None
        assert any("http" in line for line in process.stdout)
        assert list(tmp_path.glob("*/gpgrad-uploads-*"))
        process.terminate()
        _, said = process.communicate(timeout=60)
    assert process.returncode == 143
    assert said.splitlines() == ["gpgrad: terminated"]
    assert not list(tmp_path.rglob("gpgrad-*"))
    wait_for(lambda: not running(process.pid), 30)


def test_a_signal_while_all_is_loaded_is_a_line_too() -> None:
    code = "import signal; signal.raise_signal(signal.SIGTERM)"
    program = f"import sys, app.ending\nwith app.ending.termination_raised():\n    {code}"
    finished = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, env=environment(), check=False
    )
    assert b"Terminated: terminated" in finished.stderr  # raised, where main() catches it


@linux
def test_a_library_that_turns_the_signal_into_its_own_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Open3D does, while it is loaded: it cannot be loaded, it said."""

    def load(*_: object, **__: object) -> None:
        try:
            signal.raise_signal(signal.SIGTERM)
        except KeyboardInterrupt:
            raise ImportError("initialization failed") from None

    monkeypatch.setattr("app.cli.simulate.simulate_into", load)
    for _ in range(2):
        assert run(["simulate", str(tmp_path / "data")]) == 143
        assert capsys.readouterr().err == "gpgrad: terminated\n"
    assert run(["simulate", str(tmp_path), "--num-submaps", "x"]) == 2  # the signal is forgotten


JOBS = """
import os, signal, sys, threading, time
from app.cli.terminal import exit_code
from gpgrad_core.run.parallel import WORTH_PROCESSES, run_jobs, workers
from jobs import work
def locate():
    with workers(2, WORTH_PROCESSES) as executor:
        run_jobs(work, [600.0] * 4, executor, lambda _: None)
if __name__ == "__main__":
    sys.exit(exit_code(locate))
"""


@pytest.mark.slow
@linux
def test_jobs_of_ten_minutes_end_with_their_program(tmp_path: Path) -> None:
    """They were waited for, so that locate was still there 25 s after SIGTERM."""
    (tmp_path / "jobs.py").write_text(
        "import time\nfrom pathlib import Path\n"
        "def work(seconds, progress):\n"
        f"    Path({str(tmp_path)!r}, f'begun-{{time.monotonic_ns()}}').touch()\n"
        "    time.sleep(seconds)\n"
    )
    (tmp_path / "program.py").write_text(JOBS)
    with subprocess.Popen(
        [sys.executable, str(tmp_path / "program.py")],
        stderr=subprocess.PIPE,
        text=True,
        env=environment() | {"PYTHONPATH": f"{ROOT}{os.pathsep}{tmp_path}"},
        start_new_session=True,
    ) as process:
        wait_for(lambda: len(list(tmp_path.glob("begun-*"))) == 2)
        process.terminate()
        _, said = process.communicate(timeout=120)
    assert (process.returncode, said) == (143, "gpgrad: terminated\n")
    wait_for(lambda: not running(process.pid), 30)


@linux
def test_a_signal_that_python_drops_is_raised_again(capsys: pytest.CaptureFixture[str]) -> None:
    """Raised while an object was removed, it was printed, and the program went on."""

    class Removed:
        def __del__(self) -> None:
            signal.raise_signal(signal.SIGTERM)

    def work() -> None:
        removed = Removed()
        del removed
        time.sleep(5.0)
        raise AssertionError("it went on")

    assert exit_code(work) == 143
    assert capsys.readouterr().err == "gpgrad: terminated\n"


# Streams and names.


def shell(command: str, *arguments: str | Path, **variables: str) -> Finished:
    """Run ``gpgrad`` in a shell's command, where it stands for ``$@``."""
    finished = subprocess.run(
        ["sh", "-c", command, "sh", sys.executable, "-m", "app", *map(str, arguments)],
        capture_output=True,
        text=True,
        encoding="utf-8",
        cwd=ROOT,
        env=environment() | variables,
        check=False,
    )
    return Finished(finished.returncode, finished.stdout, finished.stderr)


@pytest.mark.slow
@linux
def test_closed_streams_are_no_hindrance(traverse: Path, tmp_path: Path) -> None:
    out = tmp_path / "map.npz"
    for k, closed in enumerate(("2>&-", "2>&- >&- <&-")):
        arguments = ("map", traverse / "submaps" / "000.xyz", "--out", out, *QUICK_MAP)
        finished = shell(f'"$@" {closed}', *arguments)
        assert finished.code == 0
        assert ("gpgrad: " in finished.out, bool(finished.out)) == (False, k == 0)
        np.load(out).close()
        out.unlink()


@pytest.mark.slow
@linux
def test_a_terminal_of_few_letters_shows_the_help() -> None:
    """The root of an hour ended it with a traceback."""
    finished = shell('"$@"', "slam", "--help", PYTHONIOENCODING="ascii")
    assert (finished.code, finished.err) == (0, "")
    assert "rad/\\u221am" in finished.out


@pytest.mark.usefixtures("no_work")
@pytest.mark.skipif(sys.platform != "linux", reason="other systems have no such names")
@pytest.mark.parametrize("verb", ["detect", "slam", "evaluate", "fit"])
def test_a_name_that_no_report_can_hold_is_refused(
    traverse: Path, tmp_path: Path, verb: str
) -> None:
    """It did all the work first."""
    dataset = tmp_path / os.fsdecode(b"d\xff")
    shutil.copytree(traverse, dataset)
    out = [] if verb == "fit" else ["--out", tmp_path / "a.json"]
    refused = gpgrad(verb, dataset, *out).refusal
    assert "d\\xdcff: this name is not UTF-8; rename it" in refused


# All or nothing.


@pytest.fixture(scope="module")
def short(traverse: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The two submaps of the traverse that close a loop, with a tenth of their points."""
    folder = tmp_path_factory.mktemp("short") / "short"
    shutil.copytree(traverse, folder)
    for name in ("001.xyz", "002.xyz"):
        (folder / "submaps" / name).unlink()
    for cloud in (folder / "submaps").iterdir():
        cloud.write_text("\n".join(cloud.read_text().splitlines()[::10]))
    poses = (folder / "poses_odom.txt").read_text().splitlines()
    (folder / "poses_odom.txt").write_text("\n".join((poses[0], poses[3])))
    return folder


@pytest.fixture
def closures(tmp_path: Path) -> Path:
    """Its loop closure, so that slam need not detect."""
    return write_by_hand(tmp_path / "closures.json", accepted=True)


def slam(dataset: Path, closures: Path, out: Path, *flags: str) -> int:
    arguments = ("slam", dataset, "--out", out, "--closures", closures, *flags)
    return run([*map(str, arguments), "--merged.resolution", "0.2"])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("error", "code"),
    [(OSError(errno.ENOSPC, "No space left on device"), 2), (KeyboardInterrupt(), 130)],
    ids=["full disk", "interrupted"],
)
def test_slam_leaves_nothing_half(
    short: Path,
    closures: Path,
    tmp_path: Path,
    error: BaseException,
    code: int,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """It left seven of nine files, or its folder."""

    def fail(*_: object, **__: object) -> None:
        raise error

    monkeypatch.setattr("gpgrad_core.slam.solution.write_raster", fail)  # its last file
    assert slam(short, closures, tmp_path / "map") == code
    assert names(tmp_path) == ["closures.json"]


def test_a_full_disk_names_the_file(
    traverse: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object, **__: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("app.cli.map.write_map", partial(written, full))
    out = tmp_path / "map.npz"
    line = gpgrad("map", traverse / "submaps" / "000.xyz", "--out", out, *QUICK_MAP).refusal
    assert line == f"{out}: No space left on device"
    with pytest.raises(OSError, match="map'") as error, whole_folder(tmp_path / "map"):
        full()
    assert error.value.filename == str(tmp_path / "map")
    assert names(tmp_path) == []


def written(fail: Callable[[], None], out: Path, *_: object, **__: object) -> None:
    with replacing(out):
        fail()


def test_slam_replaces_only_what_it_is_told_to(
    short: Path, closures: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "map"
    out.mkdir()
    for name in ("mine.txt", "cloud.ply", "report.json"):
        (out / name).write_text("old")
    assert slam(short, closures, out, "--no-merge") == 2
    said = capsys.readouterr().err
    assert f"{out}: holds cloud.ply of an earlier run" in said
    assert "--overwrite" in said
    assert slam(short, closures, out, "--no-merge", "--overwrite") == 0
    assert "cloud.ply" not in names(out)  # the old one does not belong to the new poses
    assert (out / "mine.txt").read_text() == "old"
    assert json.loads((out / "report.json").read_text())["dataset"] == "small traverse"


def test_an_incomplete_copy_of_a_recording_is_refused(tmp_path: Path) -> None:
    assert run(["simulate", str(tmp_path / "drive"), "--scans", "5", *TINY]) == 0
    next((tmp_path / "drive" / "scans").iterdir()).unlink()
    refused = gpgrad("build", tmp_path / "drive", "--out", tmp_path / "data").refusal
    assert "times.txt: holds 5 times for 4 scans; the recording is not complete" in refused


# Refused before the work.


@pytest.fixture
def no_work(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let every beginning of long work fail."""

    def fail(*_: object, **__: object) -> None:
        raise AssertionError("it began to work")

    for place in (
        *("gpgrad_core.simulation.simulate.run_jobs", "gpgrad_core.detection.pairs.Pairs.compare"),
        *(
            "gpgrad_core.comparing.resolve_parameters",
            "gpgrad_core.evaluation.run_methods",
            "app.cli.slam.resolved",
        ),
        "app.cli.reproduce.study",
        *("app.cli.fit.fit_parameters", "app.cli.map.infer_gradient_map"),
        *(
            "gpgrad_core.simulation.recording.make_ground",
            "gpgrad_core.recordings.build.open_recording",
        ),
    ):
        monkeypatch.setattr(place, fail)


@pytest.mark.usefixtures("no_work")
@pytest.mark.parametrize("flags", [(), ("--scans", "10")])
def test_simulate_refuses_at_once(tmp_path: Path, flags: tuple[str, ...]) -> None:
    """It worked for 50 seconds first."""
    (tmp_path / "mine.txt").touch()
    assert "is not empty" in gpgrad("simulate", tmp_path, *flags).refusal
    taken = tmp_path / "mine.txt"
    assert "is a file" in gpgrad("simulate", taken, *flags).refusal


def test_a_route_that_fits_nowhere_is_told_so(tmp_path: Path) -> None:
    """It asked for an extent of 402 m, where 240 m is the most allowed."""
    flags = ("--route", "winding", "--num-submaps", "200")
    line = gpgrad("simulate", tmp_path / "data", *flags).refusal
    assert "need an extent of 402 m, more than the 240 m allowed; lower num_submaps" in line
    line = gpgrad("simulate", tmp_path / "data", "--route", "winding").refusal
    assert "extent must be 62 m or more for 24 submaps" in line


@pytest.mark.usefixtures("no_work")
@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("detect", "{data}", "--out", "{tmp}/a.txt"), "the ending must be one of .json"),
        (("detect", "{data}", "--out", "{tmp}/no/a.json"), "there is no folder"),
        (
            (
                "detect",
                "{data}",
                "--out",
                "{tmp}/a.json",
                "--pair",
                "000",
                "001",
                "--candidates",
                "3",
            ),
            "--pair compares two submaps, and --candidates 3 says",
        ),
        (("detect", "{data}", "--out", "{tmp}/old.json"), "exists already; name another file"),
        (
            ("detect", "{data}", "--out", "{tmp}/a.json", "--g2o", "{tmp}/old.g2o"),
            "old.g2o: exists already",
        ),
        (("evaluate", "{data}", "--out", "{tmp}/no/report"), "there is no folder"),
        (("evaluate", "{data}", "--out", "{tmp}"), "holds report.json of an earlier run"),
        (("reproduce", "{data}", "--out", "{tmp}/no/figures"), "there is no folder"),
        (("reproduce", "{data}", "--out", "{tmp}"), "holds index.html of an earlier run"),
        (("slam", "{data}", "--out", "{tmp}/old.json"), "is a file"),
        (("slam", "{data}", "--out", "{tmp}"), "holds report.json of an earlier run"),
        (("slam", "{data}", "--out", "{tmp}/map", "--closures", "{tmp}/no.json"), "no.json"),
        (("map", "{data}/submaps/000.xyz", "--out", "{tmp}/a.doc"), "the ending must be one of"),
        (("fit", "{data}", "--out", "{tmp}/a.json"), "the ending must be one of .toml"),
        (("build", "{data}", "--out", "{tmp}"), "is not empty"),
    ],
)
def test_what_can_be_known_is_refused_before_the_work(
    traverse: Path, tmp_path: Path, arguments: tuple[str, ...], said: str
) -> None:
    there = ["index.html", "old.g2o", "old.json", "report.json"]
    for name in there:
        (tmp_path / name).write_text("old")
    places = {"data": traverse, "tmp": tmp_path}
    line = gpgrad(*(argument.format(**places) for argument in arguments)).refusal
    assert said in line
    assert names(tmp_path) == there


# Never over an input.


@pytest.fixture
def data(traverse: Path, tmp_path: Path) -> Path:
    """A dataset that may be spoilt, with links to it beside it."""
    shutil.copytree(traverse, tmp_path / "data")
    try:
        (tmp_path / "link").symlink_to(tmp_path / "data", target_is_directory=True)
    except OSError:
        pytest.skip("this system makes no links")
    cloud = tmp_path / "data" / "submaps" / "000.xyz"
    cloud.rename(cloud.with_suffix(".npy"))
    np.save(cloud.with_suffix(".npy"), np.loadtxt(cloud.with_suffix(".npy")))
    (tmp_path / "data" / "images").mkdir()
    (tmp_path / "mine.toml").write_text("[map]\nresolution = 0.1\n")
    (tmp_path / "cloud.npz").symlink_to(tmp_path / "data" / "submaps" / "000.npy")
    return tmp_path / "data"


@pytest.mark.usefixtures("no_work")
@pytest.mark.parametrize(
    "arguments",
    [
        "map {tmp}/x.ply --out {tmp}/x.ply",
        "map {tmp}/x.ply --out {tmp}/data/../x.ply",
        "map {data}/submaps/000.npy --out {data}/submaps/777.ply",
        "map {tmp}/x.ply --out {data}/submaps/777.ply",
        "map {tmp}/x.ply --out {tmp}/link/submaps/777.npz",
        "map {data}/submaps/000.npy --out {tmp}/cloud.npz",  # a link to it
        "fit {data} --out {data}/dataset.toml",
        "fit {tmp}/link --out {data}/dataset.toml",
        "fit {data} --out {tmp}/link/dataset.toml",
        "fit {data} --params {tmp}/mine.toml --out {tmp}/mine.toml",
        "detect {data} --out {data}/submaps/closures.json",
        "detect {data} --out {data}/images/closures.json",
        "evaluate {data} --out {data}/submaps",
        "evaluate {data} --out {tmp} --closures {tmp}/report.json --overwrite",
        "reproduce {data} --out {data}/submaps",
        "slam {data}/submaps --out {data}/submaps",
        "slam {tmp}/link --out {data}/submaps",
        "slam {data} --out {tmp} --params {tmp}/report.json --overwrite",
        "build {data} --out {data} --overwrite",
        "build {data}/submaps --out {data} --overwrite",
        "build {data} --out {tmp} --poses {tmp}/mine.toml --overwrite",
    ],
)
def test_an_output_never_replaces_an_input(data: Path, tmp_path: Path, arguments: str) -> None:
    """``map X.ply --out X.ply`` made a mesh of the cloud, and fit wrote over dataset.toml."""
    (tmp_path / "x.ply").write_bytes(b"ply")
    (tmp_path / "report.json").write_text("{}")
    before = contents(tmp_path)
    line = gpgrad(*arguments.format(data=data, tmp=tmp_path).split()).refusal
    assert "input" in line
    assert contents(tmp_path) == before


def test_other_files_in_a_dataset_may_be_written(data: Path) -> None:
    cloud, out = str(data / "submaps" / "001.xyz"), str(data / "001.npz")
    assert run(["map", cloud, "--out", out, *QUICK_MAP]) == 0
    assert (data / "001.npz").is_file()


# Replaced only where gpgrad made it.


def test_simulate_replaces_what_was_simulated(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "data"
    small = ["--max-points", "500", *TINY]
    assert run(["simulate", str(out), *small]) == 0
    before = contents(out)
    assert run(["simulate", str(out), "--seed", "1", *small]) == 2
    assert "replace what gpgrad made there: --overwrite" in capsys.readouterr().err
    assert contents(out) == before
    assert run(["simulate", str(out), "--seed", "1", "--overwrite", *small]) == 0
    assert contents(out).keys() == before.keys()
    assert contents(out) != before
    assert run(["simulate", str(out), "--scans", "3", "--overwrite", *small]) == 0
    assert names(out) == ["poses.txt", "poses_gt.txt", "scans", "times.txt"]
    assert names(tmp_path) == ["data"]


@pytest.mark.parametrize(
    "mine",
    [
        "submaps/measured.las",
        "submaps/9.ply",
        "scans/000.ply",
        "trajectory/000.csv",
        "submaps/000.ply",
    ],
)
def test_a_users_file_within_what_was_simulated_stays(tmp_path: Path, mine: str) -> None:
    out = tmp_path / "data"
    assert run(["simulate", str(out), "--max-points", "500", *TINY]) == 0
    (out / mine).parent.mkdir(exist_ok=True)
    if mine == "submaps/000.ply":
        (out / mine).unlink()
        (out / mine).mkdir()
    else:
        (out / mine).touch()
    before = names(out)
    assert f"holds {mine}, which" in gpgrad("simulate", out, "--overwrite", *TINY).refusal
    assert names(out) == before


@pytest.mark.parametrize("there", ["mine.txt", "submaps"])
def test_nothing_else_is_ever_replaced(tmp_path: Path, there: str) -> None:
    out = tmp_path / "data"
    out.mkdir()
    (out / there).mkdir()
    line = gpgrad("simulate", out, "--overwrite", *TINY).refusal
    assert ("holds mine.txt" if there == "mine.txt" else "gpgrad did not make") in line
    assert names(out) == [there]


def test_build_replaces_what_was_built(tmp_path: Path) -> None:
    params = SimulationParams(num_submaps=2, spacing=1.0, extent=16.0, max_range=3.0)
    simulate_recording(tmp_path / "drive", 6, params, points_a_scan=1000)
    arguments = ["build", str(tmp_path / "drive"), "--out", str(tmp_path / "data")]
    assert run(arguments) == 0
    before = contents(tmp_path / "data")
    assert "is not empty" in gpgrad(*arguments).refusal
    assert run([*arguments, "--overwrite", "--voxel-size", "0.2"]) == 0
    assert contents(tmp_path / "data") != before
    assert names(tmp_path) == ["data", "drive"]


INTERRUPTED_WITHIN = """
import os, signal, sys
from app.__main__ import main
from ruamel.yaml import YAML
whole = YAML.parse
def parse(self, text):
    for count, event in enumerate(whole(self, text)):
        if count == 1000:
            os.kill(os.getpid(), signal.SIGINT)
        assert count < 2000, "was not interrupted"
        yield event
YAML.parse = parse
sys.argv = ["gpgrad", "build", *sys.argv[1:]]
main()
"""


@pytest.mark.slow
def test_interrupted_while_the_metadata_of_a_bag_are_read(tmp_path: Path) -> None:
    pytest.importorskip("rosbags")
    rows = [f"k{k}: [{','.join('1' * 100)}]" for k in range(1000)]
    (tmp_path / "metadata.yaml").write_text("\n".join(rows))
    with interruptible():
        finished = subprocess.run(
            [sys.executable, "-c", INTERRUPTED_WITHIN, str(tmp_path), "--out", str(tmp_path / "d")],
            env=environment(), capture_output=True, text=True, check=False,
        )  # fmt: skip
    assert (finished.returncode, finished.stderr) == (
        130,
        "gpgrad: interrupted; run the same command to resume\n",
    )
