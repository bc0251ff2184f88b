"""The command that the viewer gives, run as a process, finds what the viewer shows."""

import json
import shlex
from dataclasses import replace
from pathlib import Path

import pytest

from app.viewer.session.session_file import detect_command
from app.viewer.session.state import open_dataset, with_pair
from gpgrad_core.detection import PipelineParams, register_pair, resolve_parameters
from gpgrad_core.io.folder import load_dataset
from gpgrad_core.params import preferred_parameters, with_path
from gpgrad_core.run.memo import Memo
from tests.end_to_end.process import gpgrad


@pytest.mark.slow
@pytest.mark.parametrize("turned", [False, True])
def test_it_gives_the_same_numbers(traverse: Path, tmp_path: Path, turned: bool) -> None:
    dataset = load_dataset(traverse)
    params = preferred_parameters(dataset, PipelineParams())
    for path, value in (
        ("map.noise_std", 0.02),
        ("map.max_points", 2500),
        ("matching.mutual", False),
        ("registration.inlier_radius", 0.1 + 0.1),
        ("registration.seed", 7),
    ):
        params = with_path(params, path, value)
    params = resolve_parameters(dataset.submaps, params)  # as the viewer does on opening
    pair = ("000", "003") if turned else ("003", "000")
    state = with_pair(
        replace(open_dataset(dataset, params), source=str(traverse)),
        query_id=pair[0],
        database_id=pair[1],
    )
    shown = register_pair(state.query, state.database, params, Memo()).closure
    program, *words = shlex.split(detect_command(state))
    assert program == "gpgrad"
    words[words.index("closures.json")] = str(tmp_path / "closures.json")
    finished = gpgrad(*words)
    assert finished.code == 0, finished.err
    (record,) = json.loads((tmp_path / "closures.json").read_text())["pairs"]
    registration = shown.registration
    assert (record["query"], record["database"]) == pair
    assert record["num_inliers"] == registration.num_inliers > 0
    assert record["accepted"] is shown.accepted
    assert record["reason"] == shown.reason
    motion = registration.T_database_query
    assert motion is not None
    for told, exact in (
        (record["score"], registration.score),
        (record["T_database_query"]["x"], motion.x),
        (record["T_database_query"]["y"], motion.y),
        (record["T_database_query"]["yaw"], motion.yaw),
    ):
        assert told == float(f"{exact:.9g}")  # all digits that the file has
