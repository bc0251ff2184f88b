"""The report of a pair in words: its command, a page that opens from disk, and lines of text."""

import base64
import shlex
import textwrap
from pathlib import Path

from app.viewer.features.pair import figures_of, headline_of, in_words, sentences_of, whole_sentence
from app.viewer.session.methods import METHODS
from app.viewer.session.session_file import SavedSession
from app.viewer.session.state import ViewState
from gpgrad_core.detection import PairResult, PipelineParams
from gpgrad_core.evaluation.report import render
from gpgrad_core.io.records.closures import Decision
from gpgrad_core.params import AUTOMATIC, get_path, number_text, parameters_of, preferred_parameters
from gpgrad_core.version import VERSION


def detect_command(state: ViewState, *, alone: bool = True) -> str:
    """Write the ``gpgrad detect`` command that gives exactly the numbers shown.

    Only what differs from what the dataset takes by itself is named. A pair that was judged alone
    is named too: the other way round it would be another registration, and all other pairs would
    take their time.
    """
    words = ["gpgrad", "detect", str(Path(state.source).absolute()), "--out", "closures.json"]
    words += ["--pair", state.query_id, state.database_id] if alone else []
    if state.method != SavedSession.method:
        words += ["--method", state.method]
    base = preferred_parameters(state.dataset, PipelineParams())
    words += flags(state.asked, METHODS[state.method].adapt(base))
    return shlex.join(words)


def page_commands(state: ViewState, *, decided: bool = False) -> list[str]:
    """Write the commands that make the page of the whole dataset; none if it has no path.

    What a person decided is in the file that *Export closures* saves, and no command finds it.
    """
    if not state.source:
        return []
    has_truth = len(state.dataset.true_poses) >= 2
    words = ["gpgrad", "evaluate" if has_truth else "slam", str(Path(state.source).absolute())]
    words += ["--closures", "closures.json", "--out", "page"]
    return [*([] if decided else [detect_command(state, alone=False)]), shlex.join(words)]


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


UNTOUCHED = Decision()


def report_html(
    state: ViewState,
    result: PairResult,
    picture: bytes,
    *,
    link: str = "",
    decision: Decision = UNTOUCHED,
) -> str:
    """Write the page, with a picture in PNG; all it needs is in it.

    The link is an address that shows the same in a viewer; it may be empty. What a person decided
    about the pair comes first.
    """
    pair = f"query {state.query_id}, database {state.database_id}"
    return render(
        Path(__file__).with_name("report.html"),
        title=f"{state.dataset.name}: {pair}",
        headline=headline_of(result, with_score=True, decided=decision.accepted),
        threshold=number_text(METHODS[state.method].lowest(state.params)),
        words=words_of(state, result, decision),
        note=decision.note,
        rows=figures_of(state, result),
        picture=base64.b64encode(picture).decode("ascii"),
        command=command_of(state, result),
        link=link,
        method=state.method,
        parameters=_parameters(state),
        version=VERSION,
    )


def words_of(state: ViewState, result: PairResult, decision: Decision) -> str:
    """Write the sentences of the card, without the headline."""
    sentences = (whole_sentence(sentence.text) for sentence in sentences_of(state, result))
    return " ".join((in_words(state, result, decided=decision.accepted), *sentences))


def lines_below(
    state: ViewState, result: PairResult, *, link: str = "", decision: Decision = UNTOUCHED
) -> str:
    """Write what stands below the figure of a report that is one picture."""
    figures = " · ".join(f"{row.name} {row.text}" for row in figures_of(state, result))
    changed = [f"{path} {value}" for path, value, differs in _parameters(state) if differs]
    blocks = [
        words_of(state, result, decision),
        *([f"Note: {decision.note}"] if decision.note else []),
        figures,
        f"Method: {state.method}",
        "Parameters: " + (", ".join(changed) or "defaults"),
        "Command: " + command_of(state, result),
        *([f"Link: {link}"] if link else []),
        f"gpgrad {VERSION}",
    ]
    # A line is broken where it would leave the picture.
    folded = textwrap.TextWrapper(140, subsequent_indent="    ", break_on_hyphens=False)
    return "\n".join(part for block in blocks for part in folded.wrap(block))


def command_of(state: ViewState, result: PairResult) -> str:
    """Write the command that finds the same; say why where there is none."""
    if not state.source:
        return "none: the dataset has no path"
    return detect_command(state, alone=result.closure.context is None)


def _parameters(state: ViewState) -> list[tuple[str, str, bool]]:
    """List the parameters: name, value with unit, and whether something else was asked for."""
    base = METHODS[state.method].adapt(PipelineParams())
    rows: list[tuple[str, str, bool]] = []
    for field in parameters_of(PipelineParams):
        value, asked = get_path(state.params, field.path), get_path(state.asked, field.path)
        text = f"{value:g}" if type(value) is float else str(value)
        unit = "" if field.bounds is None else f" {field.bounds.unit}".rstrip()
        if asked is None:
            text, unit = ("automatic", "") if value is None else (text, f"{unit}, automatic")
        rows.append((field.path, text + unit, asked != get_path(base, field.path)))
    return rows
