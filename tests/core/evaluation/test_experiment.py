"""Methods run in turn, and files of others under names of their own."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gpgrad_core.detection import PipelineParams
from gpgrad_core.detection.verdict import ClosureParams
from gpgrad_core.errors import InputError
from gpgrad_core.evaluation import read_rivals, run_methods
from gpgrad_core.evaluation.experiment import detect_stored
from gpgrad_core.io.records.closures import write_closures
from gpgrad_core.methods import Method
from gpgrad_core.run.memo import Memo
from gpgrad_core.run.store import Store
from gpgrad_core.se2 import SE2
from gpgrad_core.types import LoopDetector, Registration, Submap
from tests.core.evaluation.squares import DATASET, closure, report


def nearness(_params: PipelineParams, _memo: Memo) -> LoopDetector:
    """A detector that cheats: it scores by the distance of the true places."""

    def detect(query: Submap, database: Submap) -> Registration:
        apart = np.linalg.norm(query.pose_true.translation - database.pose_true.translation)
        score = 100 / (1 + float(apart))
        return Registration(SE2(), np.ones(10, bool), 1.0, 1.0, 0.5, score)

    return detect


CHEAT = Method("cheat", "Looks at the truth.", nearness)


def test_any_loop_detector_can_be_run() -> None:
    fractions: list[float] = []
    again = Method("again", "Looks twice.", nearness)
    found = run_methods(DATASET, [CHEAT, again], progress=fractions.append)
    assert list(found) == ["cheat", "again"]
    assert found["cheat"].method == "cheat"
    assert len(found["cheat"].pairs) == 10
    best = max(found["cheat"].pairs, key=lambda pair: pair.registration.score)
    assert set(best.pair) == {"000", "003"}
    assert fractions == sorted(fractions)
    assert fractions[-1] == pytest.approx(1.0)


def test_a_method_given_twice_is_refused() -> None:
    with pytest.raises(InputError, match="'cheat' is given twice"):
        run_methods(DATASET, [CHEAT, CHEAT])


def test_files_get_names_of_their_own(tmp_path: Path) -> None:
    paths = [tmp_path / f"{name}.json" for name in "abc"]
    for path, method in zip(paths, ("gradient", "slam", "slam"), strict=True):
        write_closures(path, report(closure("001", "000"), method=method))
    assert list(read_rivals(paths)) == ["gradient", f"slam ({paths[1]})", f"slam ({paths[2]})"]
    assert list(read_rivals(paths[:2], taken=["gradient"])) == [f"gradient ({paths[0]})", "slam"]
    with pytest.raises(InputError, match=r"a\.json: is given twice"):
        read_rivals([paths[0], paths[0]])


class Interrupted(Exception):
    pass


def test_a_stopped_search_goes_on_where_it_was(tmp_path: Path) -> None:
    compared: list[tuple[str, str]] = []

    def counting(params: PipelineParams, memo: Memo) -> LoopDetector:
        detect = nearness(params, memo)

        def count(query: Submap, database: Submap) -> Registration:
            if len(compared) == stop_at:
                raise Interrupted
            compared.append((query.id, database.id))
            return detect(query, database)

        return count

    method = Method("counting", "Counts.", counting)
    params, store = PipelineParams(), Store(tmp_path / "cache")
    stop_at = 6
    with pytest.raises(Interrupted):
        detect_stored(DATASET, method, params, store)
    stop_at = -1
    fractions: list[float] = []
    whole = detect_stored(DATASET, method, params, store, progress=fractions.append)
    pairs = [one.pair for one in whole.closures]
    ids = [submap.id for submap in DATASET.submaps]
    assert pairs == [(query, database) for k, query in enumerate(ids) for database in ids[:k]]
    assert len(compared) < 6 + len(pairs)  # what was handed over before is not compared again
    assert fractions[-1] == 1.0
    before = len(compared)
    again = detect_stored(DATASET, method, params, store)
    assert len(compared) == before
    scores = [one.registration.score for one in whole.closures]
    assert [one.registration.score for one in again.closures] == scores
    other = replace(params, closure=replace(params.closure, min_inliers=11))
    assert not any(one.accepted for one in detect_stored(DATASET, method, other, store).closures)
    assert len(compared) == before + len(pairs)  # a verdict belongs to its parameters


def test_verdicts_with_images_are_not_kept(tmp_path: Path) -> None:
    store = Store(tmp_path / "cache")
    params = PipelineParams(closure=ClosureParams(images="show"))
    detect_stored(DATASET, CHEAT, params, store)
    assert not (tmp_path / "cache").exists()
