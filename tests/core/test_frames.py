"""Nothing depends on where a submap's frame lies, and on how it is turned."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from gpgrad_core import demo_path, detect_loop_closures, evaluate, load_dataset
from gpgrad_core.detection import DetectionResult
from gpgrad_core.evaluation.rules import EvaluationParams
from gpgrad_core.io.records.closures import read_closures, report_closures, write_closures
from gpgrad_core.se2 import SE2
from gpgrad_core.slam import LoopCloser, build_pose_graph, optimise_pose_graph
from gpgrad_core.slam.errors import trajectory_error
from gpgrad_core.types import Dataset
from tests.support.frames import SHIFTS, TURNED, UTM, in_frame

SHOWN = ("001", "002", "007", "008")
"""Submaps of the demo that are compared, on the way out and back."""


def detect(dataset: Dataset) -> DetectionResult:
    with ThreadPoolExecutor(2) as executor:
        return detect_loop_closures(dataset, executor=executor)


def check_same(
    dataset: Dataset, here: DetectionResult, there: DetectionResult, frame: SE2, most: float
) -> None:
    """Check verdicts, motions of the ground up to a distance [m], and what was fitted.

    Cells lie along a frame's axes, so a turn samples the same ground at other places.
    """
    share = 0.01 if frame.yaw else 0.001
    assert here.params is not None
    assert there.params is not None
    for name in ("length_scale", "noise_std", "signal_std", "scale"):
        fitted = (getattr(params.map, name) for params in (here.params, there.params))
        assert next(fitted) == pytest.approx(next(fitted), rel=share), name
    centres = {submap.id: submap.centre[None, :2] for submap in dataset.submaps}
    for near, far in zip(here.closures, there.closures, strict=True):
        assert (near.accepted, near.query_id) == (far.accepted, far.query_id)
        if not near.accepted:
            continue
        own, other = (one.registration.T_database_query for one in (near, far))
        assert own is not None
        assert other is not None
        again = frame.inverse() @ (other @ frame)
        centre = centres[near.query_id]
        assert np.linalg.norm(again.apply(centre) - own.apply(centre)) < most
        stds = [one.registration.position_std for one in (near, far)]
        assert stds[1] == pytest.approx(stds[0], rel=0.25)


@pytest.fixture(scope="module")
def demo() -> Dataset:
    whole = load_dataset(demo_path())
    shown = (whole.submap(name) for name in SHOWN)
    some = (replace(submap, points=submap.points[::8]) for submap in shown)
    return in_frame(replace(whole, submaps=tuple(some)), SE2())


@pytest.fixture(scope="module")
def found(demo: Dataset) -> DetectionResult:
    return detect(demo)


@pytest.fixture(
    scope="module",
    params=[
        pytest.param(SHIFTS[0], marks=pytest.mark.slow, id="60 m away"),
        pytest.param(UTM, id="UTM"),
    ],
)
def far(request: pytest.FixtureRequest, demo: Dataset) -> tuple[SE2, Dataset, DetectionResult]:
    moved = in_frame(demo, request.param)
    return request.param, moved, detect(moved)


def test_closures_do_not_depend_on_where_a_frame_lies(
    demo: Dataset, found: DetectionResult, far: tuple[SE2, Dataset, DetectionResult]
) -> None:
    assert sum(closure.accepted for closure in found.closures) >= 4
    check_same(demo, found, far[2], far[0], most=0.001)


@pytest.mark.slow
def test_closures_do_not_depend_on_a_frames_heading(demo: Dataset, found: DetectionResult) -> None:
    turned = in_frame(demo, TURNED[1])
    check_same(demo, found, detect(turned), TURNED[1], most=0.03)


def test_a_map_is_corrected_and_judged_alike(
    demo: Dataset, found: DetectionResult, far: tuple[SE2, Dataset, DetectionResult]
) -> None:
    _, moved, again = far
    centres: list[np.ndarray] = []
    errors: list[float] = []
    for dataset, result in ((demo, found), (moved, again)):
        graph = build_pose_graph(dataset, result.closures)
        solved = optimise_pose_graph(graph)
        poses, halfway = (graph.at_centres(some) for some in (solved.poses, solved.at(0.5)))
        placed = [*poses.values(), *halfway.values(), *solved.centred.at(0.5).values()]
        centres.append(np.array([pose.translation for pose in placed]))
        errors.append(trajectory_error(graph.at_centres(dataset.true_poses), poses).absolute)
    np.testing.assert_allclose(centres[1], centres[0], atol=0.002)
    assert errors[1] == pytest.approx(errors[0], abs=0.002)
    (near,), (other,) = (
        evaluate(dataset, {"gradient": result}, EvaluationParams(num_resamples=0)).methods
        for dataset, result in ((demo, found), (moved, again))
    )
    shown = near.ranking.accepted
    np.testing.assert_allclose(other.errors.offset[shown], near.errors.offset[shown], atol=0.002)
    assert other.accepted == near.accepted


def test_a_drive_closes_its_loops_alike(
    demo: Dataset, found: DetectionResult, far: tuple[SE2, Dataset, DetectionResult]
) -> None:
    pairs = []
    for dataset, params in ((demo, found.params), (far[1], far[2].params)):
        assert params is not None
        with LoopCloser(params, search_radius=12.0) as closer:
            for submap in dataset.submaps:
                closer.add(submap)
            pairs.append((len(closer.closures), closer.accepted_pairs))
    assert pairs[0] == pairs[1]


def test_files_keep_far_motions(tmp_path: Path, far: tuple[SE2, Dataset, DetectionResult]) -> None:
    _, moved, again = far
    assert again.params is not None
    path = tmp_path / "closures.json"
    write_closures(path, report_closures(moved, again, again.params))
    for pair, closure in zip(read_closures(path).pairs, again.closures, strict=True):
        motion, read = closure.registration.T_database_query, pair.registration.T_database_query
        centre = moved.submap(closure.query_id).centre[None, :2]
        if motion is not None and read is not None:
            assert np.linalg.norm(read.apply(centre) - motion.apply(centre)) < 1e-4
        if closure.accepted:
            assert pair.registration.covariance is not None
            covariances = (pair.registration.covariance, closure.registration.covariance)
            np.testing.assert_allclose(*covariances, rtol=1e-6, atol=1e-10)


@pytest.mark.nightly
@pytest.mark.parametrize("name", ["demo", "marsyard2021", "apollo15"])
def test_frames_anywhere(name: str, request: pytest.FixtureRequest) -> None:
    real = name != "demo"
    folder = request.getfixturevalue("real_data") / name if real else demo_path()
    dataset = load_dataset(folder)
    dataset = replace(dataset, submaps=dataset.submaps[:12])
    here = detect(dataset)

    @settings(max_examples=3, deadline=None, suppress_health_check=[HealthCheck.too_slow])
    @given(st.floats(-10_000, 10_000), st.floats(-10_000, 10_000), st.sampled_from((SE2(), UTM)))
    def shifted(x: float, y: float, origin: SE2) -> None:
        frame = SE2(origin.x + x, origin.y + y)
        check_same(dataset, here, detect(in_frame(dataset, frame)), frame, most=0.001)

    shifted()
