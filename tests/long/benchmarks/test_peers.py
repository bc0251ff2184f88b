"""The peers are asked the right question, and their cost is measured right.

A peer that is not installed is skipped.
"""

import json
from dataclasses import replace
from functools import cache, partial

import numpy as np
import pytest
from scipy.linalg import cho_solve

from gpgrad_core.gp.kernel import SquaredExponential
from tests.long.benchmarks.bench_peers import measure_part
from tests.long.benchmarks.peers import tables
from tests.long.benchmarks.peers.adapters import DENSE, METHODS, OURS, SkiSettings, gpytorch_ski
from tests.long.benchmarks.peers.cases import NOISE, Answer, Case, Errors, Task
from tests.long.benchmarks.peers.measure import Caps, Run, measure
from tests.long.benchmarks.peers.plan import TARGETS, Part
from tests.long.benchmarks.peers.worker import Cost
from tests.support.dense import covariance, fit_dense

TASK = Case(250, side=2.5, resolution=0.1).task()


@cache
def oracle() -> Answer:
    return METHODS[DENSE].solve(TASK)


def errors_of(method: str) -> Errors:
    if not METHODS[method].available:
        pytest.skip(f"{METHODS[method].needs} is not installed")
    return Errors.between(METHODS[method].solve(TASK), oracle(), TASK.signal_std)


@pytest.mark.filterwarnings("ignore")  # the libraries' own
@pytest.mark.parametrize("method", ["scikit-learn", "GPyTorch exact", "GSTools"])
def test_exact_peers_give_the_oracles_answer(method: str) -> None:
    errors = errors_of(method)
    assert errors.elevation < 1e-6
    assert errors.std_anywhere is not None
    assert errors.std_anywhere < 1e-6
    assert errors.slope is None or errors.slope < 1e-6


def with_unknown_mean(task: Task) -> Answer:
    """Add to the oracle what an unknown mean does to it: ordinary kriging."""
    kernel = SquaredExponential(task.signal_std, task.length_scale)
    posterior = fit_dense(task.points, kernel, NOISE)
    ones = np.ones(len(task.points))
    pull = cho_solve((posterior.factor, True), ones)
    mean = float(pull @ task.heights / (pull @ ones))
    lack = 1 - covariance(kernel, task.grid.positions, task.xy) @ pull  # of the mean in each cell
    known = oracle()
    assert known.std is not None
    variance = known.std.ravel() ** 2 + lack**2 / (pull @ ones)
    return Answer.of_cells(task, known.elevation.ravel() - task.mean + lack * mean, variance)


@pytest.mark.filterwarnings("ignore")
def test_pykrige_differs_by_its_unknown_mean_alone() -> None:
    pytest.importorskip("pykrige")
    answer, expected = METHODS["PyKrige"].solve(TASK), with_unknown_mean(TASK)
    assert answer.std is not None
    assert expected.std is not None
    assert np.abs(answer.elevation - expected.elevation).max() < 1e-9
    assert np.abs(answer.std / expected.std - 1).max() < 1e-6


@pytest.mark.filterwarnings("ignore")
def test_pykrige_window_with_all_neighbours_is_pykrige() -> None:
    pytest.importorskip("pykrige")
    few = Case(90, side=1.5, resolution=0.1).task()
    window, whole = (METHODS[name].solve(few) for name in ("PyKrige, 100 nearest", "PyKrige"))
    assert window.std is not None
    assert whole.std is not None
    assert np.abs(window.elevation - whole.elevation).max() < 1e-9
    assert np.abs(window.std / whole.std - 1).max() < 1e-6


@pytest.mark.filterwarnings("ignore")
def test_ski_nears_the_oracle_as_its_grid_grows_finer() -> None:
    pytest.importorskip("gpytorch")
    coarse, fine = (
        Errors.between(
            gpytorch_ski(TASK, SkiSettings(spacing, 250, 1e-6)), oracle(), TASK.signal_std
        )
        for spacing in (0.5, 0.125)
    )
    assert fine.all_below(coarse)
    assert fine.elevation < 1e-3
    assert fine.slope is not None
    assert fine.slope < 0.01
    assert fine.std_anywhere is not None
    assert fine.std_anywhere < 0.01


def test_smoothed_grid_finds_the_slope_of_a_plane() -> None:
    task = Case(20_000, side=2.0, resolution=0.05).task()
    plane = np.column_stack([task.xy, 0.2 * task.xy[:, 0] - 0.1 * task.xy[:, 1]])
    answer = METHODS["smoothed grid"].solve(replace(task, points=plane))
    assert answer.slope is not None
    assert answer.std is None
    middle = answer.slope[12:-12, 12:-12]
    assert np.abs(middle - [0.2, -0.1]).max() < 0.01


def test_an_answer_survives_its_file(tmp_path) -> None:  # noqa: ANN001
    answer = METHODS["smoothed grid"].solve(TASK)
    answer.save(tmp_path / "answer.npz")
    read = Answer.load(tmp_path / "answer.npz")
    assert read.std is None
    assert np.array_equal(read.elevation, answer.elevation)
    assert read.fields == "elevation, slopes"


def test_a_run_costs_what_it_holds() -> None:
    case = Case(1500, side=5.0, resolution=0.25)
    run, answer = measure(DENSE, case, Caps())
    assert answer is not None
    assert run.cost is not None
    matrix = 8e-6 * case.num_points**2  # [MB]
    assert matrix < run.cost.peak_mb < 10 * matrix
    assert run.cost.seconds > 0
    assert Run.from_dict(json.loads(json.dumps(run.as_dict()))) == run


@pytest.mark.parametrize(
    ("caps", "failure"), [(Caps(seconds=0.1), "over 0.1 s"), (Caps(megabytes=40), "over 40 MB")]
)
def test_a_run_over_its_cap_is_ended(caps: Caps, failure: str) -> None:
    run, answer = measure(DENSE, Case(3000, side=8.0, resolution=0.1), caps)
    assert answer is None
    assert run.cost is None
    assert run.failure == failure


def test_what_a_peer_says_of_its_failure_is_kept() -> None:
    run, _ = measure(OURS, Case(300, side=2.0, resolution=1e-4), Caps())
    assert run.cost is None
    assert "resolution must be from" in run.failure


def test_a_method_over_a_cap_is_spared_larger_cases() -> None:
    cases = (Case(1500, 5.0, 0.25), Case(1600, 5.0, 0.25))
    part = Part("", cases, ("smoothed grid", DENSE), Caps(megabytes=15), growing=True)
    grid_small, grid_large, dense_small = measure_part(part, ())
    assert [grid_small.case, grid_large.case, dense_small.case] == [*cases, cases[0]]
    assert grid_large.cost is not None
    assert dense_small.failure == "over 15 MB"


EXACT = Errors(0.001, 0.001, 0.001, 0.001)
LOOSE = Errors(0.5, 0.5, 0.5, 0.5)


def reach(method: str, case: Case, seconds: float, errors: Errors | None = EXACT) -> Run:
    return Run(method, case, Cost(seconds, (seconds,), 10.0), errors, "elevation, std, slopes")


def test_targets_are_met_or_not() -> None:
    ours = [reach(OURS, target.case, 0.1) for target in TARGETS]
    dense = [reach(DENSE, target.case, 60.0) for target in TARGETS]
    assert tables.check_targets([*ours, *dense])[1]
    assert not tables.check_targets(ours)[1]  # nothing to be faster than
    slow = [reach(OURS, TARGETS[0].case, 0.5), *ours[1:]]
    assert not tables.check_targets([*slow, *dense])[1]
    off = [reach(OURS, TARGETS[0].case, 0.1, replace(EXACT, std_anywhere=0.06)), *ours[1:]]
    text, met = tables.check_targets([*off, *dense])
    assert not met
    assert text.count("NO") == 1


def test_peers_are_to_be_slower_and_ski_less_exact_too() -> None:
    case, ski = Case(5000), "GPyTorch SKI, grid 0.25 l, rank 100, cg 0.01"
    run = partial(reach, case=case)
    good = [run(OURS, seconds=0.1), run("GSTools", seconds=11.0), run(ski, seconds=1, errors=LOOSE)]
    assert tables.check_peers(good)[1]
    assert not tables.check_peers([good[0], run("GSTools", seconds=9.0)])[1]
    assert not tables.check_peers([good[0], run(ski, seconds=1.0, errors=replace(LOOSE, slope=0))])[
        1
    ]
    ended = Run("GSTools", case, failure="over 900 s")
    assert tables.check_peers([good[0], ended])[1]
    assert not tables.check_peers([good[0], replace(ended, failure="over 5 s")])[1]
    assert not tables.check_peers([good[0], replace(ended, failure="over 8000 MB")])[1]
