"""A viewer that follows a robot, both killed at any moment: what was acknowledged is there."""

import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

import gpgrad_core as gg
from gpgrad_core.live.keeping import Keeper
from gpgrad_core.slam import read_run
from tests.core.live.submaps import row
from tests.end_to_end.process import ROOT, environment, gpgrad, start
from tests.support.waiting import until

NUM_SUBMAPS = 30
ROBOT = """
import sys
import gpgrad_core as gg
from tests.core.live.submaps import row
with gg.Live(sys.argv[1], patience=300.0) as live:
    for submap in row(int(sys.argv[2])):
        if submap.id not in live.kept:
            live.add(submap.points, submap.pose_odometry, id=submap.id, wait=False)
            print(submap.id, flush=True)
"""


def free_port() -> int:
    import socket  # noqa: PLC0415

    with socket.create_server(("127.0.0.1", 0)) as taken:
        return int(taken.getsockname()[1])


def viewer(folder: Path, port: int) -> "subprocess.Popen[str]":
    return start(
        *("view", "--follow", f"{port}", "--record", f"{folder / 'run.gpgrad'}", "--no-open"),
        *("--port", "0", "--track", f"{folder / 'track.txt'}", "--config", f"{folder}"),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    )


def robot(port: int) -> "subprocess.Popen[str]":
    return subprocess.Popen(
        [sys.executable, "-c", ROBOT, f"localhost:{port}", f"{NUM_SUBMAPS}"],
        cwd=ROOT,
        env=environment() | {"PYTHONPATH": str(ROOT)},
        stdout=subprocess.PIPE,
        text=True,
    )


@pytest.mark.nightly
@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no SIGKILL")
def test_ten_kills_lose_nothing_that_was_acknowledged(tmp_path: Path) -> None:
    pytest.importorskip("gtsam", reason="GTSAM has no wheels for this system")
    rng, port = random.Random(5), free_port()
    acknowledged: set[str] = set()
    there, here = viewer(tmp_path, port), robot(port)
    for kill in range(10):
        time.sleep(rng.uniform(0.2, 4.0))
        if kill % 2:
            here.kill()
            said, _ = here.communicate()
            acknowledged |= set(said.split())
            here = robot(port)
        else:
            there.kill()
            there.communicate()
            if (tmp_path / "run.gpgrad").exists():
                kept = {submap.id for submap in read_run(tmp_path / "run.gpgrad").submaps}
                assert acknowledged <= kept
            there = viewer(tmp_path, port)
    said, _ = here.communicate(timeout=300)  # it goes on to its end
    assert here.returncode == 0
    acknowledged |= set(said.split())
    track = tmp_path / "track.txt"
    until(
        lambda: track.exists() and len(track.read_text().splitlines()) == NUM_SUBMAPS + 1,
        "the whole track",
        300.0,
    )
    there.send_signal(signal.SIGTERM)
    _, errors = there.communicate(timeout=120)
    assert there.returncode == 143
    assert "Traceback" not in errors
    run = read_run(tmp_path / "run.gpgrad")
    ids = [submap.id for submap in run.submaps]
    assert ids == [submap.id for submap in row(NUM_SUBMAPS)]
    assert acknowledged <= set(ids)
    assert [moment.submap_id for moment in run.moments] == ids
    assert run.notes == ()
    keeper = Keeper(tmp_path / "run.gpgrad")
    assert list(keeper.names) == ids
    keeper.close()


@pytest.mark.slow
def test_standard_input_is_followed_to_its_end(tmp_path: Path) -> None:
    pytest.importorskip("gtsam", reason="GTSAM has no wheels for this system")
    from gpgrad_core.live.frames import frame_of, submitted  # noqa: PLC0415

    frames = b"".join(
        frame_of(submitted(submap.points, submap.pose_odometry, submap.id))
        for submap in row(3)
        if submap.pose_odometry is not None
    )
    process = subprocess.Popen(
        [
            *(sys.executable, "-m", "app", "view", "--follow", "-", "--no-open", "--port", "0"),
            *("--record", str(tmp_path / "run.gpgrad"), "--config", str(tmp_path)),
        ],
        cwd=ROOT,
        env=environment(),
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
    )
    assert process.stdin is not None
    assert process.stdout is not None
    process.stdin.write(frames)
    process.stdin.close()
    said = next((line for line in process.stdout if b"has ended" in line), b"")
    process.terminate()
    process.stdout.read()
    process.wait(120)
    process.stdout.close()
    assert said.decode().strip() == "standard input has ended: 3 submaps compared"
    assert len(read_run(tmp_path / "run.gpgrad").moments) == 3


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--follow", "nowhere"), "nowhere: there is no such file or folder"),
        (("--track", "t.txt"), "go with --follow"),
        (("x", "--follow", "0"), "does not go with a DATASET"),
        (("--follow", "0", "--record", "run.json"), "the ending must be one of .gpgrad"),
        (("--follow", "0", "--track", "README.md"), "README.md: is no track"),
    ],
)
def test_what_cannot_be_followed_is_refused(arguments: tuple[str, ...], said: str) -> None:
    finished = gpgrad("view", *arguments, "--no-open")
    assert finished.code == 2
    assert said in finished.err
    assert len(finished.err.splitlines()) == 1


def test_the_client_is_public() -> None:
    assert "Live" in gg.__all__
