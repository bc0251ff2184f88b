"""The report of a pair in words: its command, a page that opens from disk, and lines of text."""

import base64
import textwrap
from pathlib import Path

from app.viewer.features.pair import figures_of, headline_of, in_words, sentences_of, whole_sentence
from app.viewer.session.methods import METHODS
from app.viewer.session.session_file import detect_command
from app.viewer.session.state import ViewState
from gpgrad_core import __version__
from gpgrad_core.detection import PairResult, PipelineParams
from gpgrad_core.evaluation.report import render
from gpgrad_core.io.records.closures import Decision
from gpgrad_core.params import number_text, parameters_in_words

UNTOUCHED = Decision()


def report_html(
    state: ViewState,
    result: PairResult,
    picture: bytes,
    *,
    link: str = "",
    decision: Decision = UNTOUCHED,
) -> str:
    """Write the page, which needs no other file, with a picture in PNG; the link may be empty."""
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
        version=__version__,
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
        f"gpgrad {__version__}",
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
    base = METHODS[state.method].adapt(PipelineParams())
    return parameters_in_words(state.params, state.asked, base)
