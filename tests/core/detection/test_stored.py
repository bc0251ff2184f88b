"""The pipeline over a store: the same results, and nothing made twice."""

import math
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import cache
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
from tests.support.cancelling import cancelling
from tests.support.closures import verdicts_of
from tests.support.ground import Ground

PARAMS = PipelineParams(
    map=MapParams(length_scale=0.5, noise_std=0.02, resolution=0.15, scale=0.3),
    registration=RegistrationParams(inlier_radius=0.3),
)


GROUND = Ground.random(3, shortest=0.7, std=0.2)


def seen(x: float, seed: int) -> Submap:
    rng = np.random.default_rng(seed)
    xy = rng.uniform(-3, 3, (1200, 2))
    z = GROUND.height(SE2(x, 0.0, 0.0).apply(xy)) + 0.01 * rng.standard_normal(len(xy))
    return Submap.from_points(np.column_stack([xy, z]), f"{seed}")


DATASET = Dataset("a traverse", tuple(seen(x, k) for k, x in enumerate((0.0, 0.5, 30.0, 1.0))))


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


def run(store: Store | None, params: PipelineParams = PARAMS, **named: Any) -> DetectionResult:
    LOADED.drop_to(0)
    detector = with_store(Counting(params, Memo()), store)
    return detect_loop_closures(DATASET, params, detector=detector, **named)


def ran() -> tuple[int, int]:
    """How many maps and pairs were made since this was asked last."""
    made = Counting.made.count("map"), Counting.made.count("pair")
    Counting.made.clear()
    return made


@cache
def without_a_store(params: PipelineParams) -> DetectionResult:
    result = run(None, params)
    assert ran() == (4, 6)
    return result


def assert_same(first: DetectionResult, second: DetectionResult) -> None:
    assert len(first.closures) == math.comb(len(DATASET.submaps), 2)
    assert verdicts_of(first.closures) == verdicts_of(second.closures)


def check(
    store: Store, maps: int, pairs: int, params: PipelineParams = PARAMS, **named: Any
) -> DetectionResult:
    """A run over a store makes so many maps and pairs, and gives what one without it gives."""
    expected = without_a_store(params)
    result = run(store, params, **named)
    assert ran() == (maps, pairs)
    assert_same(result, expected)
    return result


@pytest.mark.slow
def test_a_second_run_is_the_same_and_makes_nothing(tmp_path: Path) -> None:
    check(Store(tmp_path), 4, 6)
    with ThreadPoolExecutor(2) as executor:
        again = check(Store(tmp_path), 0, 0, executor=executor)
    assert any(closure.accepted for closure in again.closures)


@pytest.mark.slow
def test_verdicts_are_handed_over_and_submaps_loaded_only_if_needed(tmp_path: Path) -> None:
    folder, loaded = tmp_path / "data", list[str]()
    write_dataset(DATASET, folder)
    expected = verdicts_of(detect_loop_closures(load_dataset(folder), PARAMS).closures)
    outlined, sources = open_dataset(folder, most_bytes=0)
    noted = [Noted(source, loaded) for source in sources]
    for loads in (["0", "1", "2", "3"], []):
        detector = with_store(Counting(PARAMS, Memo()), Store(tmp_path / "kept"))
        taken = list[LoopClosure]()
        Pairs(outlined.submaps, PARAMS, detector).compare(sources=noted, on_verdict=taken.append)
        assert verdicts_of(taken) == expected
        assert loaded == loads
        loaded.clear()
    # A detector that keeps nothing loads them itself.
    taken = list[LoopClosure]()
    plain = detect_loop_closures(outlined, PARAMS, sources=sources, take=taken.append)
    assert plain.closures == ()
    assert verdicts_of(taken) == expected


WIDER = replace(PARAMS, registration=RegistrationParams(inlier_radius=0.5))


@pytest.mark.slow
def test_another_threshold_compares_nothing_and_another_radius_makes_no_map(tmp_path: Path) -> None:
    check(Store(tmp_path), 4, 6)
    strict = replace(PARAMS, closure=replace(PARAMS.closure, min_score=1000.0))
    refused = check(Store(tmp_path), 0, 0, strict)
    assert not any(closure.accepted for closure in refused.closures)
    check(Store(tmp_path), 0, 6, WIDER)
    check(Store(tmp_path), 4, 6, replace(PARAMS, map=replace(PARAMS.map, length_scale=0.6)))


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
    for params in (PARAMS, WIDER):  # the candidates follow from the keypoints
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


@pytest.mark.slow
def test_a_run_that_was_stopped_goes_on_where_it_was(tmp_path: Path) -> None:
    with pytest.raises(Cancelled):
        run(Store(tmp_path), progress=cancelling(0.6))
    maps, pairs = ran()
    assert maps == 4
    assert 1 <= pairs < 6
    check(Store(tmp_path), 0, 6 - pairs)


@pytest.mark.slow
def test_damaged_views_are_made_anew_and_counted(tmp_path: Path) -> None:
    store = Store(tmp_path)
    check(store, 4, 6)
    views = sorted(tmp_path.rglob(f"*{ENDING}"))
    assert len(views) == 8  # keypoints, and what is prepared
    for file in views:
        file.write_bytes(file.read_bytes()[:10_000])
    check(store, 4, 6, WIDER)
    assert store.take_damaged() == 8


@pytest.mark.slow
def test_a_store_that_is_too_small_or_cannot_be_written_changes_nothing(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("x")
    check(Store(tmp_path, max_bytes=1_500_000), 4, 6)
    check(Store(tmp_path / "file" / "kept"), 4, 6)


@pytest.mark.parametrize("name", ["elevation", "smoothed", "fpfh"])
def test_rivals_are_not_kept(name: str, tmp_path: Path) -> None:
    detector = METHODS[name].detector(METHODS[name].adapt(PARAMS), Memo())
    assert with_store(detector, Store(tmp_path)) is detector
    own = METHODS["gradient"].detector(PARAMS, Memo())
    assert isinstance(with_store(own, Store(tmp_path)), StoredDetector)
    assert with_store(own, None) is own
