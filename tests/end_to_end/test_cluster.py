"""`gpgrad detect --scheduler`: a cluster of two processes gives the same file as this machine."""

import json
import os
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from gpgrad_core.detection import (
    DetectionResult,
    MapDetector,
    PipelineParams,
    detect_loop_closures,
    with_store,
)
from gpgrad_core.errors import InputError
from gpgrad_core.io.folder import load_dataset
from gpgrad_core.mapping.gradient_map import MapParams
from gpgrad_core.run import Progress, silent
from gpgrad_core.run.memo import Memo
from gpgrad_core.run.parallel import connected
from gpgrad_core.run.store import Store
from gpgrad_core.simulation.demo import demo_path
from gpgrad_core.types import Dataset
from tests.end_to_end.process import gpgrad

distributed = pytest.importorskip("distributed")
PARAMS = PipelineParams(map=MapParams(length_scale=0.3, noise_std=0.05, resolution=0.06, scale=0.2))


@pytest.fixture(scope="module")
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    with distributed.LocalCluster(
        n_workers=2,
        threads_per_worker=1,
        processes=True,
        dashboard_address=None,
        local_directory=str(tmp_path_factory.mktemp("dask")),
    ) as started:
        yield started


def content(path: Path) -> dict[str, Any]:
    read = json.loads(path.read_text())
    read.pop("seconds")
    return read


@pytest.mark.parametrize(
    "kept",
    [
        pytest.param(True, marks=pytest.mark.slow, id="by path"),
        pytest.param(False, marks=pytest.mark.nightly, id="by value"),
    ],
)
def test_the_same_file_as_on_one_machine(
    traverse: Path, cluster: Any, tmp_path: Path, kept: bool
) -> None:
    alone, beside = tmp_path / "alone.json", tmp_path / "beside.json"
    assert gpgrad("detect", traverse, "--out", alone, "--cache", "none").code == 0
    finished = gpgrad(
        *("detect", traverse, "--out", beside, "--scheduler", cluster.scheduler_address),
        *("--cache", tmp_path / "kept" if kept else "none"),
    )
    assert finished.code == 0, finished.err
    assert content(beside) == content(alone)
    assert (tmp_path / "kept").exists() == kept
    assert not list((tmp_path / "kept").glob(".gpgrad-*"))


def detected(
    dataset: Dataset, store: Store | None, progress: Progress = silent, **named: Any
) -> DetectionResult:
    detector = with_store(MapDetector(PARAMS, Memo()), store)
    return detect_loop_closures(dataset, PARAMS, detector=detector, progress=progress, **named)


def verdicts(result: DetectionResult) -> list[tuple[Any, ...]]:
    return [
        (
            closure.query_id,
            closure.database_id,
            closure.reason,
            closure.registration.T_database_query,
        )
        for closure in result.closures
    ]


@pytest.mark.nightly
def test_a_worker_that_dies_costs_its_own_jobs_only(cluster: Any, tmp_path: Path) -> None:
    dataset = load_dataset(demo_path())
    killed: list[int] = []
    with connected(cluster.scheduler_address) as executor:
        assert executor.num_workers == 2
        pids = distributed.Client(cluster).run(os.getpid)

        def kill_one(fraction: float) -> None:
            if fraction > 0.6 and not killed:
                killed.append(next(iter(pids.values())))
                os.kill(killed[0], signal.SIGKILL)

        beside = detected(dataset, Store(tmp_path), kill_one, executor=executor)
    assert killed
    assert verdicts(beside) == verdicts(detected(dataset, None))


@pytest.mark.nightly
def test_files_that_only_this_machine_has_are_told_apart(cluster: Any, tmp_path: Path) -> None:
    file = tmp_path / "cloud"
    file.write_text("x")
    with connected(cluster.scheduler_address) as executor:
        assert executor.sees(file)
        assert executor.sees(tmp_path)
        assert not executor.sees(tmp_path / "nothing")


@pytest.mark.slow
def test_where_no_scheduler_is_the_line_says_what_to_do(traverse: Path, tmp_path: Path) -> None:
    address = "tcp://127.0.0.1:9"
    line = gpgrad("detect", traverse, "--out", tmp_path / "c.json", "--scheduler", address).refusal
    assert f"--scheduler {address}: no Dask scheduler answers there" in line
    assert "start one with: dask scheduler" in line
    assert not (tmp_path / "c.json").exists()
    with pytest.raises(InputError, match="no Dask scheduler"), connected("nonsense"):
        pass
