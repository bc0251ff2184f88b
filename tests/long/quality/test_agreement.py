"""The same pairs, bit for bit, whoever asks and whatever does the work.

A dataset takes some minutes.
"""

import json
import re
import subprocess
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, ThreadPoolExecutor
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import pytest

from gpgrad_core.detection import PipelineParams, detect_loop_closures
from gpgrad_core.io.folder import load_dataset
from gpgrad_core.io.records.closures import report_closures, write_closures
from gpgrad_core.params import preferred_parameters
from gpgrad_core.run.parallel import WORTH_PROCESSES, workers
from gpgrad_core.simulation.demo import demo_path
from tests.end_to_end.process import environment, start
from tests.support.page import ProtocolPage

SETS = ("demo", "marsyard2021")


@pytest.fixture(scope="module", params=SETS)
def dataset(request: pytest.FixtureRequest, real_data: Path) -> Path:
    return demo_path() if request.param == "demo" else real_data / request.param


def content(path: Path) -> dict[str, Any]:
    """What the file says; floats are written so that they are read back to the bit."""
    read = json.loads(path.read_text())
    for name in ("seconds", "num_pairs_skipped"):
        read.pop(name)
    return read


@pytest.fixture(scope="module")
def alone(dataset: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """Of the Python API, in one thread."""
    return by_api(dataset, tmp_path_factory.mktemp("alone") / "closures.json", nullcontext)


def by_api(dataset: Path, out: Path, make: Callable[[], Any]) -> dict[str, Any]:
    loaded = load_dataset(dataset)
    params = preferred_parameters(loaded, PipelineParams())
    with make() as executor:
        result = detect_loop_closures(loaded, params, executor=executor)
    write_closures(out, report_closures(loaded, result, params, method="gradient"))
    return content(out)


def by_command(dataset: Path, out: Path, *flags: str | Path, **variables: str) -> dict[str, Any]:
    with start(
        *("detect", dataset, "--out", out, *flags),
        env=environment() | variables,
        stderr=subprocess.PIPE,
    ) as process:
        _, said = process.communicate(timeout=1200)
    assert process.returncode == 0, said
    assert said == ""
    return content(out)


def processes() -> Executor:
    return workers(2, WORTH_PROCESSES)


@pytest.mark.parametrize("make", [lambda: ThreadPoolExecutor(4), processes], ids=["threads", "two"])
def test_the_python_api(
    dataset: Path, alone: dict[str, Any], make: Callable[[], Executor], tmp_path: Path
) -> None:
    assert by_api(dataset, tmp_path / "closures.json", make) == alone


@pytest.mark.parametrize("threads", ["1", "2", "5"])
def test_the_command(dataset: Path, alone: dict[str, Any], threads: str, tmp_path: Path) -> None:
    out = tmp_path / "closures.json"
    assert by_command(dataset, out, "--cache", "none", GPGRAD_THREADS=threads) == alone


def test_the_command_with_kept_results(
    dataset: Path, alone: dict[str, Any], tmp_path: Path
) -> None:
    for turn in ("made", "kept"):
        flags = ("--cache", tmp_path / "kept")
        assert by_command(dataset, tmp_path / f"{turn}.json", *flags) == alone, turn


def test_a_cluster(dataset: Path, alone: dict[str, Any], tmp_path: Path) -> None:
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, dashboard_address=None, local_directory=str(tmp_path)
    ) as cluster:
        flags = ("--scheduler", cluster.scheduler_address, "--cache", "none")
        assert by_command(dataset, tmp_path / "closures.json", *flags) == alone


class Downloading(ProtocolPage):
    """Keeps the files that it is sent."""

    def __init__(self, url: str) -> None:
        self.parts: dict[str, dict[int, bytes]] = {}
        self.whole: dict[str, bytes] = {}
        self._about: dict[str, dict[str, Any]] = {}
        super().__init__(url)

    def take(self, message: dict[str, Any]) -> None:
        super().take(message)
        if message["type"] == "FileTransferStartDownload":
            self._about[message["transfer_uuid"]] = message
        elif message["type"] == "FileTransferPart":
            transfer = message["transfer_uuid"]
            parts = self.parts.setdefault(transfer, {})
            parts[message["part_index"]] = message["content"]
            about = self._about[transfer]
            if len(parts) == about["part_count"]:
                self.whole[about["filename"]] = b"".join(parts[k] for k in sorted(parts))


@pytest.fixture
def page(dataset: Path, tmp_path: Path) -> Iterator[Downloading]:
    flags = ("--port", "0", "--no-open", "--cache", "none", "--config", tmp_path / "config")
    with start("view", dataset, *flags, stdout=subprocess.PIPE) as process:
        try:
            assert process.stdout is not None
            said = next((line for line in process.stdout if "http" in line), "")
            address = re.search(r"http://[^/\s]+", said)
            assert address, said
            visitor = Downloading(address[0])
            yield visitor
            visitor.close()
        finally:
            process.terminate()


def test_the_viewer(
    dataset: Path, alone: dict[str, Any], page: Downloading, tmp_path: Path
) -> None:
    """All pairs first, which the export then takes from memory; and it shows as many."""
    del dataset
    page.wait(lambda: page.find("Run all pairs") is not None, "the panel", 120)
    page.set("Run all pairs", True)
    accepted = sum(pair["accepted"] for pair in alone["pairs"])
    told = f"{accepted} loop closures in "
    page.wait(lambda: told in page.html(), told, 600)
    page.set("Export closures", True)
    page.wait(lambda: "closures.json" in page.whole, "the file", 600)
    out = tmp_path / "closures.json"
    out.write_bytes(page.whole["closures.json"])
    assert content(out)["pairs"] == alone["pairs"]
