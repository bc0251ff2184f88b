"""The report as a page that opens from disk, and as lines of text for a picture."""

import base64
import textwrap
from pathlib import Path

from app.viewer.features.pair import headline_of, in_words, rows_of
from app.viewer.features.save.command_line import detect_command
from app.viewer.session.methods import METHODS
from app.viewer.session.state import ViewState
from gpgrad_core.detection import PairResult, PipelineParams
from gpgrad_core.evaluation.pages import render
from gpgrad_core.params.bounds import number_text
from gpgrad_core.params.fields import get_path, parameters_of
from gpgrad_core.version import VERSION

TEMPLATE = Path(__file__).with_name("report.html")
LONGEST_LINE = 140
"""Letters of a line below the figure."""


def report_html(
    state: ViewState, result: PairResult, picture: bytes, *, link: str = "", decided: str = ""
) -> str:
    """Write the page; all it needs is in it.

    Args:
        state: What was judged.
        result: What was found.
        picture: The figure as PNG.
        link: Address that shows the same in a viewer; empty if there is none.
        decided: What a person has decided about the pair; empty if nothing.
    """
    pair = f"query {state.query_id}, database {state.database_id}"
    return render(
        TEMPLATE,
        title=f"{state.dataset.name}: {pair}",
        headline=headline_of(result, with_score=True),
        threshold=number_text(METHODS[state.method].lowest(state.params)),
        words=in_words(state, result),
        decided=decided,
        rows=rows_of(state, result),
        picture=base64.b64encode(picture).decode("ascii"),
        command=command_of(state),
        link=link,
        method=state.method,
        parameters=_parameters(state),
        version=VERSION,
    )


def lines_below(state: ViewState, result: PairResult, *, link: str = "", decided: str = "") -> str:
    """Write what stands below the figure of a report that is one picture."""
    figures = " · ".join(f"{row.name} {row.value}" for row in rows_of(state, result))
    changed = [f"{path} {value}" for path, value, differs in _parameters(state) if differs]
    blocks = [
        in_words(state, result),
        *([decided] if decided else []),
        figures,
        f"Method: {state.method}",
        "Parameters: " + (", ".join(changed) or "defaults"),
        "Command: " + command_of(state),
        *([f"Link: {link}"] if link else []),
        f"gpgrad {VERSION}",
    ]
    return "\n".join(part for block in blocks for part in _folded(block))


def command_of(state: ViewState) -> str:
    """Write the command that finds the same; say why where there is none."""
    if not state.source:
        return "none: the dataset has no path"
    return detect_command(state)


def _folded(text: str) -> list[str]:
    """Break a line where it would leave the picture."""
    return textwrap.wrap(text, LONGEST_LINE, subsequent_indent="    ", break_on_hyphens=False)


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
