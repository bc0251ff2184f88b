"""The pipeline over a store: the same results, and nothing made twice."""

import math
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gpgrad_core.detection import (
    DetectionResult,
    MapDetector,
    Pairs,
    PipelineParams,
    StoredDetector,
    detect_loop_closures,
    with_store,
)
from gpgrad_core.detection.shortlist import Candidate, Shortlist
from gpgrad_core.detection.stored import LOADED
from gpgrad_core.io.folder import load_dataset, open_dataset, write_dataset
from gpgrad_core.mapping.gradient_map import MapParams
from gpgrad_core.methods import METHODS
from gpgrad_core.registration import RegistrationParams
from gpgrad_core.run import Cancelled, Progress, silent
from gpgrad_core.run.memo import Memo
from gpgrad_core.run.store import ENDING, Store
from gpgrad_core.se2 import SE2
from gpgrad_core.types import (
    Dataset,
    Features,
    GradientMap,
    LoopClosure,
    Registration,
    Submap,
    SubmapSource,
)
from tests.support.ground import Ground

PARAMS = PipelineParams(
    map=MapParams(length_scale=0.5, noise_std=0.02, resolution=0.15, scale=0.3),
    registration=RegistrationParams(inlier_radius=0.3),
)


def seen(ground: Ground, x: float, seed: int) -> Submap:
    rng = np.random.default_rng(seed)
    xy = rng.uniform(-3, 3, (1200, 2))
    z = ground.height(SE2(x, 0.0, 0.0).apply(xy)) + 0.01 * rng.standard_normal(len(xy))
    return Submap.from_points(np.column_stack([xy, z]), f"{seed}")


GROUND = Ground.random(3, shortest=0.7, std=0.2)
PLACES = (0.0, 0.5, 30.0, 1.0)
DATASET = Dataset("a traverse", tuple(seen(GROUND, x, k) for k, x in enumerate(PLACES)))


class Counting(MapDetector):
    """Notes what is really made."""

    made: list[str] = []  # noqa: RUF012 - of the class, for all of a test

    def infer(self, submap: Submap, progress: Progress = silent) -> GradientMap:
        Counting.made.append("map")
        return super().infer(submap, progress)

    def compare(self, query: object, database: object) -> Registration:
        Counting.made.append("pair")
        return super().compare(query, database)  # type: ignore[arg-type]


class Noted:
    """A source that notes when it is loaded."""

    def __init__(self, source: SubmapSource, loaded: list[str]) -> None:
        self.source, self.loaded = source, loaded

    def __getattr__(self, name: str) -> Any:
        return getattr(self.source, name)

    def load(self) -> Submap:
        self.loaded.append(self.source.id)
        return self.source.load()


@pytest.fixture(autouse=True)
def _as_a_new_process() -> None:
    Counting.made.clear()
    LOADED.drop_to(0)


def run(store: Store | None, params: PipelineParams = PARAMS, **named: object) -> DetectionResult:
    LOADED.drop_to(0)
    detector = with_store(Counting(params, Memo()), store)
    return detect_loop_closures(DATASET, params, detector=detector, **named)  # type: ignore[arg-type]


def ran() -> list[str]:
    made = sorted(Counting.made)
    Counting.made.clear()
    return made


def assert_same(first: DetectionResult, second: DetectionResult) -> None:
    assert len(first.closures) == len(second.closures) == math.comb(len(DATASET.submaps), 2)
    for one, other in zip(first.closures, second.closures, strict=True):
        assert (one.query_id, one.database_id) == (other.query_id, other.database_id)
        assert (one.accepted, one.reason) == (other.accepted, other.reason)
        assert one.registration.score == other.registration.score
        assert one.registration.T_database_query == other.registration.T_database_query
        np.testing.assert_array_equal(one.registration.inliers, other.registration.inliers)


@pytest.mark.slow
def test_a_second_run_is_the_same_and_makes_nothing(tmp_path: Path) -> None:
    without = run(None)
    assert ran() == 4 * ["map"] + 6 * ["pair"]
    assert_same(run(Store(tmp_path)), without)
    assert ran() == 4 * ["map"] + 6 * ["pair"]
    with ThreadPoolExecutor(2) as executor:
        assert_same(run(Store(tmp_path), executor=executor), without)
    assert ran() == []
    assert any(closure.accepted for closure in without.closures)


@pytest.mark.slow
def test_verdicts_are_handed_over_and_submaps_loaded_only_if_needed(tmp_path: Path) -> None:
    folder, taken, loaded = tmp_path / "data", list[LoopClosure](), list[str]()
    write_dataset(DATASET, folder)
    outlined, sources = open_dataset(folder, most_bytes=0)
    noted = [Noted(source, loaded) for source in sources]
    for loads in (["0", "1", "2", "3"], []):
        detector = with_store(Counting(PARAMS, Memo()), Store(tmp_path / "kept"))
        pairs = Pairs(outlined.submaps, PARAMS, detector)
        pairs.compare(sources=noted, on_verdict=taken.append)
        result = pairs.result()
        assert loaded == loads
        loaded.clear()
    assert_same(
        replace(result, closures=tuple(taken[6:])), replace(result, closures=tuple(taken[:6]))
    )
    second = replace(result, closures=tuple(taken[6:]))
    # A detector that keeps nothing loads them itself.
    taken.clear()
    plain = detect_loop_closures(outlined, PARAMS, sources=sources, take=taken.append)
    assert plain.closures == ()
    plain = replace(plain, closures=tuple(taken))
    assert_same(plain, second)
    assert_same(plain, detect_loop_closures(load_dataset(folder), PARAMS))


@pytest.mark.slow
def test_another_threshold_compares_nothing_and_another_radius_makes_no_map(tmp_path: Path) -> None:
    run(Store(tmp_path))
    ran()
    strict = replace(PARAMS, closure=replace(PARAMS.closure, min_score=1000.0))
    assert not any(closure.accepted for closure in run(Store(tmp_path), strict).closures)
    assert ran() == []
    wider = replace(PARAMS, registration=RegistrationParams(inlier_radius=0.5))
    assert_same(run(Store(tmp_path), wider), run(None, wider))
    assert ran() == 4 * ["map"] + 12 * ["pair"]
    smoother = replace(PARAMS, map=replace(PARAMS.map, length_scale=0.6))
    run(Store(tmp_path), smoother)
    assert ran() == 4 * ["map"] + 6 * ["pair"]


@pytest.mark.slow
def test_candidates_are_found_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[int] = []
    find = Shortlist.candidates

    def counted(
        self: Shortlist, features: Features, count: int, among: object, *, promising: bool
    ) -> tuple[Candidate, ...]:
        asked.append(len(self))
        assert among is None  # all of them
        return find(self, features, count, promising=promising)

    monkeypatch.setattr(Shortlist, "candidates", counted)
    without = run(None, candidates=1)
    assert asked == [2, 3]
    asked.clear()
    assert run(Store(tmp_path), candidates=1).shortlists == without.shortlists
    assert asked == [2, 3]
    asked.clear()
    other = replace(PARAMS, registration=RegistrationParams(inlier_radius=0.5))
    for params in (PARAMS, other):  # the candidates follow from the keypoints
        assert run(Store(tmp_path), params, candidates=1).shortlists == without.shortlists
    assert asked == []
    run(Store(tmp_path), candidates=2)
    assert asked == [3]
    asked.clear()
    # Behind other submaps everything is found anew, and only that.
    fewer = replace(DATASET, submaps=(*DATASET.submaps[:3], DATASET.submaps[0]))
    fewer = replace(fewer, submaps=(*fewer.submaps[:3], replace(fewer.submaps[3], id="again")))
    detector = with_store(Counting(PARAMS, Memo()), Store(tmp_path))
    detect_loop_closures(fewer, PARAMS, detector=detector, candidates=1)
    assert asked == [3]
    ran()


@pytest.mark.slow
def test_a_run_that_was_stopped_goes_on_where_it_was(tmp_path: Path) -> None:
    without = run(None)
    ran()

    def stop(fraction: float) -> None:
        if fraction > 0.6:
            raise Cancelled

    with pytest.raises(Cancelled):
        run(Store(tmp_path), progress=stop)
    before = ran()
    assert before.count("map") == 4
    assert 1 <= before.count("pair") < 6
    assert_same(run(Store(tmp_path)), without)
    assert ran() == (6 - before.count("pair")) * ["pair"]


@pytest.mark.slow
def test_damaged_views_are_made_anew_and_counted(tmp_path: Path) -> None:
    store = Store(tmp_path)
    run(store)
    ran()
    views = sorted(tmp_path.rglob(f"*{ENDING}"))
    assert len(views) == 8  # keypoints, and what is prepared
    for file in views:
        file.write_bytes(file.read_bytes()[:10_000])
    wider = replace(PARAMS, registration=RegistrationParams(inlier_radius=0.5))
    assert_same(run(store, wider), run(None, wider))
    assert ran() == 8 * ["map"] + 12 * ["pair"]
    assert store.take_damaged() == 8


@pytest.mark.slow
def test_a_store_that_is_too_small_or_cannot_be_written_changes_nothing(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("x")
    without = run(None)
    assert_same(run(Store(tmp_path, max_bytes=1_500_000)), without)
    assert_same(run(Store(tmp_path / "file" / "kept")), without)


@pytest.mark.parametrize("name", ["elevation", "smoothed", "fpfh"])
def test_rivals_are_not_kept(name: str, tmp_path: Path) -> None:
    detector = METHODS[name].detector(METHODS[name].adapt(PARAMS), Memo())
    assert with_store(detector, Store(tmp_path)) is detector
    own = METHODS["gradient"].detector(PARAMS, Memo())
    assert isinstance(with_store(own, Store(tmp_path)), StoredDetector)
    assert with_store(own, None) is own
