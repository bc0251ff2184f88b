"""The viewer's scene of a pair in a notebook, by viser's own serializer.

`gpgrad_core.show` shows pairs and datasets without viser; this is the scene as the viewer draws it,
in which the query glides into place.
"""

import io
import sys
from contextlib import AbstractContextManager, redirect_stdout
from importlib import import_module
from pathlib import Path
from tempfile import TemporaryDirectory

from app.viewer.features.demo.pages import write_story
from app.viewer.features.demo.story import story_of
from app.viewer.session.methods import register_pair
from app.viewer.session.state import ViewState, with_params
from gpgrad_core.detection import PipelineParams, resolve_parameters
from gpgrad_core.pages import Inline
from gpgrad_core.run.memo import Memo
from gpgrad_core.types import Dataset


def _quietly() -> AbstractContextManager[object]:
    """Keep a cell's output free of what is printed; in a notebook viser prints by IPython."""
    if "IPython" in sys.modules:
        return import_module("IPython.utils.capture").capture_output()
    return redirect_stdout(io.StringIO())


def scene_of_pair(
    dataset: Dataset,
    query_id: str,
    database_id: str,
    params: PipelineParams | None = None,
    *,
    memo: Memo | None = None,
    height: int = 600,
) -> Inline:
    """Show the viewer's scene of a pair in a notebook; no server stays behind.

    Args:
        dataset: The dataset.
        query_id: Submap that is placed.
        database_id: Submap that it is placed on.
        params: Parameters of all stages; what is automatic is fitted to the dataset.
        memo: Shares results with other calls.
        height: Height of the frame [pixels of the page].

    Raises:
        InputError: If there is no such submap, or a map cannot be inferred.
    """
    memo = memo or Memo()
    for name in (query_id, database_id):
        dataset.submap(name)  # refuses one that is not there
    used = resolve_parameters(dataset.submaps, params or PipelineParams(), memo)
    state = with_params(ViewState(dataset, query_id, database_id), used)
    result = register_pair(*state.pair, state.given, memo)
    with TemporaryDirectory(prefix="gpgrad-inline-") as folder:
        path = Path(folder, "scene.html")
        with _quietly():  # viser says where its server is, which ends at once
            steps = story_of(state, result, closes_map=False)
            write_story(state, result, steps, memo, False, path)
        # viser's page keeps settings in its browser, which a closed frame forbids.
        return Inline(path.read_text(encoding="utf-8"), height, closed=False)
