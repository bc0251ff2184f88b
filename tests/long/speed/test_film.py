"""How long a film takes, on an idle machine: of 15 s at 720p, a minute at most."""

import time
from pathlib import Path

import cv2

from app.viewer.features.demo.film import write_steps
from app.viewer.features.demo.story import story_of
from app.viewer.session.methods import register_pair
from app.viewer.session.state import open_dataset, with_pair
from gpgrad_core.detection import PipelineParams, resolve_parameters
from gpgrad_core.io.folder import load_dataset
from gpgrad_core.run import silent
from gpgrad_core.run.memo import Memo
from gpgrad_core.simulation.demo import demo_path

LONGEST = 60.0


def test_a_film_takes_at_most_a_minute(tmp_path: Path) -> None:
    dataset, memo = load_dataset(demo_path()), Memo(10**9)
    used = resolve_parameters(dataset.submaps, PipelineParams(), memo)
    state = open_dataset(dataset, PipelineParams(), used=used)
    state = with_pair(state, query_id="007", database_id="001")
    result = register_pair(*state.pair, state.given, memo, silent, method=state.method)
    story, path = story_of(state, result, closes_map=False), tmp_path / "film.webm"
    start = time.monotonic()
    write_steps(state, result, story, memo, True, path, silent)
    seconds = time.monotonic() - start
    film = cv2.VideoCapture(str(path))
    length = film.get(cv2.CAP_PROP_FRAME_COUNT) / film.get(cv2.CAP_PROP_FPS)
    print(f"\n{length:.1f} s of film in {seconds:.1f} s, {path.stat().st_size / 1e6:.1f} MB")
    assert 13.0 < length < 17.0
    assert seconds < LONGEST
