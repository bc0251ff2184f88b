"""`gpgrad view`, as a process."""

import re
import signal
import subprocess
import urllib.error
import urllib.request
import zipfile
from pathlib import Path

import numpy as np
import pytest

from gpgrad_core.slam.run_file import MAGIC
from tests.end_to_end.process import gpgrad, start


@pytest.mark.slow
@pytest.mark.parametrize("built_in", [False, True])
def test_the_page_is_served_until_interrupted(traverse: Path, built_in: bool) -> None:
    dataset = [] if built_in else [str(traverse), "--memory", "1.5GB"]
    with start(
        *("view", *dataset, "--port", "0", "--no-open"),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    ) as process:
        try:
            assert process.stdout is not None
            said = next((line for line in process.stdout if "http" in line), "")
            address = re.search(r"http://\S+", said)
            assert address, said
            assert said.startswith("The viewer is at http://127.0.0.1:")
            memory = process.stdout.readline()
            size = r"[\d.]+ [GM]B" if built_in else r"1\.5 GB"
            assert re.fullmatch(rf"Memory: up to {size} \(--memory changes it\)\n", memory)
            with urllib.request.urlopen(address[0], timeout=120) as page:
                assert page.status == 200
                assert b"<html" in page.read().lower()
            process.send_signal(signal.SIGINT)
            _, err = process.communicate(timeout=120)
        finally:
            process.kill()
    assert process.returncode == 130
    assert err.splitlines() == ["gpgrad: interrupted"]


@pytest.mark.slow
def test_on_a_network_the_token_is_printed_and_asked_for() -> None:
    with start(
        *("view", "--host", "0.0.0.0", "--port", "0", "--no-open"),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    ) as process:
        try:
            assert process.stdout is not None
            said = next((line for line in process.stdout if "http://" in line), "")
            link = re.search(r"(http://localhost:\d+)/\?token=(\S+)", said)
            assert link
            with urllib.request.urlopen(link[0], timeout=120) as page:
                assert page.status == 200
                assert link[2] in page.headers["Set-Cookie"]
            with pytest.raises(urllib.error.HTTPError, match="403"):
                urllib.request.urlopen(link[1], timeout=120)
        finally:
            process.kill()


@pytest.mark.parametrize(
    ("flag", "value", "said"),
    [
        ("--host", "256.1.1.1", "--host 256.1.1.1: cannot serve there"),
        ("--host", "192.0.2.1", "--host 192.0.2.1: cannot serve there"),  # nobody's, by RFC 5737
        ("--port", "65536", "--port must be from 0 to 65535, got 65536"),
    ],
)
def test_an_address_that_is_not_here_is_refused(
    traverse: Path, flag: str, value: str, said: str
) -> None:
    assert said in gpgrad("view", traverse, "--no-open", flag, value).refusal


def with_poses(folder: Path, inner: str, row: str) -> Path:
    """Write a recording of four scans, with a file of poses."""
    (folder / inner).mkdir(parents=True)
    for k in range(4):
        np.save(folder / inner / f"{k:06d}.npy", np.random.default_rng(k).normal(size=(50, 3)))
    rows = "".join(row.format(k=k) + "\n" for k in range(4))
    (folder / "poses.txt").write_text(rows)
    return folder


@pytest.mark.parametrize(
    ("inner", "row"),
    [
        ("scans", "{k} 0 0 0 0 0 0 1"),
        ("velodyne", "1 0 0 {k} 0 1 0 0 0 0 1 0"),
        (".", "1 0 0 {k} 0 1 0 0 0 0 1 0"),
        (".", "{k}.25 0 0 0 0 0 0 1"),
        ("bag", ""),
    ],
)
def test_a_recording_is_told_to_be_built_first(tmp_path: Path, inner: str, row: str) -> None:
    path = tmp_path / "my drive"
    if inner == "bag":
        path = tmp_path / "my drive.bag"
        path.write_bytes(b"#ROSBAG V2.0\n")
    else:
        with_poses(path, inner, row)
    for verb in (
        ("view", "--no-open"),
        ("detect", "--out", tmp_path / "c.json"),
        ("slam", "--out", tmp_path / "map"),
    ):
        assert gpgrad(verb[0], path, *verb[1:]).refusal == (
            f"{path}: is a recording, not a dataset: build its submaps first, and open these: "
            f"gpgrad build '{path}' --out 'my drive-submaps'"
        )


@pytest.mark.parametrize("verb", ["detect", "evaluate", "slam"])
def test_a_run_or_an_archive_says_what_opens_it(tmp_path: Path, verb: str) -> None:
    run, archive = tmp_path / "a run.gpgrad", tmp_path / "data.zip"
    run.write_bytes(MAGIC)
    with zipfile.ZipFile(archive, "w") as file:
        file.writestr("submaps/000.xyz", "0 0 0")
    for path, rule in (
        (run, f"is the record of a drive, not a dataset: gpgrad view '{run}' shows it"),
        (archive, "is an archive: unpack it"),
    ):
        refused = gpgrad(verb, path, "--out", tmp_path / "out.json").refusal
        assert refused.startswith(f"{path}: {rule}")


def test_a_wrong_dataset_is_not_taken_for_a_recording(tmp_path: Path) -> None:
    path = with_poses(tmp_path / "data", ".", "{k} 0 0 0 0 0 0 1")
    with (path / "poses.txt").open("a") as file:
        file.write("9 0 0 0 0 0 0 1\n")
    said = gpgrad("view", path, "--no-open").refusal
    assert "poses.txt, line 5" in said
    assert "recording" not in said
