"""The command that gives the result that is shown."""

import shlex
from pathlib import Path

from app.viewer.session.methods import METHODS
from app.viewer.session.session_file import SavedSession
from app.viewer.session.state import ViewState
from gpgrad_core.detection import PipelineParams
from gpgrad_core.params.fields import AUTOMATIC, get_path, parameters_of
from gpgrad_core.params.files import preferred_parameters


def detect_command(state: ViewState) -> str:
    """Write the ``gpgrad detect`` command that gives exactly the numbers shown.

    Only what differs from what the dataset takes by itself is named. The pair is named too: the
    other way round it would be another registration, and all other pairs would take their time.

    Args:
        state: What is shown.
    """
    words = ["gpgrad", "detect", str(Path(state.source).absolute()), "--out", "closures.json"]
    words += ["--pair", state.query_id, state.database_id]
    if state.method != SavedSession.method:
        words += ["--method", state.method]
    base = preferred_parameters(state.dataset, PipelineParams())
    words += flags(state.asked, METHODS[state.method].adapt(base))
    return shlex.join(words)


def flags(params: PipelineParams, base: PipelineParams) -> list[str]:
    """List the command-line flags that turn a base into params."""
    words: list[str] = []
    for setting in parameters_of(type(params)):
        value = get_path(params, setting.path)
        if value == get_path(base, setting.path):
            continue
        group, _, name = setting.path.replace("_", "-").rpartition(".")
        if setting.kind is bool:
            words.append(f"--{group}.{name}" if value else f"--{group}.no-{name}")
        else:
            # repr of a float is the shortest text that reads back as the same number.
            text = value if isinstance(value, str) else AUTOMATIC if value is None else repr(value)
            words += [f"--{group}.{name}", text]
    return words
