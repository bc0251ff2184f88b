"""Methods run in turn, and files of others under names of their own."""

from pathlib import Path

import numpy as np
import pytest

from gpgrad_core.errors import InputError
from gpgrad_core.evaluation import read_rivals, run_methods
from gpgrad_core.methods import Method
from gpgrad_core.outputs import write_closures
from gpgrad_core.pipeline import PipelineParams
from gpgrad_core.run.memo import Memo
from gpgrad_core.se2 import SE2
from gpgrad_core.types import Dataset, LoopDetector, Registration, Submap
from tests.core.evaluation.conftest import record, registration, report


def nearness(_params: PipelineParams, _memo: Memo) -> LoopDetector:
    """A detector that cheats: it scores by the distance of the true places."""

    def detect(query: Submap, database: Submap) -> Registration:
        assert query.pose_true is not None
        assert database.pose_true is not None
        apart = np.linalg.norm(query.pose_true.translation - database.pose_true.translation)
        return registration(100 / (1 + float(apart)), SE2(), 10)

    return detect


CHEAT = Method("cheat", "Looks at the truth.", nearness)


def test_any_loop_detector_can_be_run(dataset: Dataset) -> None:
    fractions: list[float] = []
    again = Method("again", "Looks twice.", nearness)
    found = run_methods(dataset, [CHEAT, again], progress=fractions.append)
    assert list(found) == ["cheat", "again"]
    assert found["cheat"].method == "cheat"
    assert len(found["cheat"].pairs) == 10
    best = max(found["cheat"].pairs, key=lambda pair: pair.score)
    assert {best.query, best.database} == {"000", "003"}
    assert fractions == sorted(fractions)
    assert fractions[-1] == pytest.approx(1.0)


def test_a_method_given_twice_is_refused(dataset: Dataset) -> None:
    with pytest.raises(InputError, match="'cheat' is given twice"):
        run_methods(dataset, [CHEAT, CHEAT])


def test_files_get_names_of_their_own(tmp_path: Path) -> None:
    paths = [tmp_path / f"{name}.json" for name in "abc"]
    for path, method in zip(paths, ("gradient", "slam", "slam"), strict=True):
        write_closures(path, report(record("001", "000"), method=method))
    assert list(read_rivals(paths)) == ["gradient", f"slam ({paths[1]})", f"slam ({paths[2]})"]
    assert list(read_rivals(paths[:2], taken=["gradient"])) == [f"gradient ({paths[0]})", "slam"]
    with pytest.raises(InputError, match=r"a\.json: is given twice"):
        read_rivals([paths[0], paths[0]])
