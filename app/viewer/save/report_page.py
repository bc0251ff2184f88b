"""The report as a page that opens from disk, and as lines of text for a picture."""

import base64
import textwrap
from html import escape

from app.viewer.methods import METHODS
from app.viewer.pair import headline_of, in_words, rows_of
from app.viewer.save.command_line import detect_command
from app.viewer.state import ViewState
from gpgrad_core.params.bounds import number_text
from gpgrad_core.params.fields import get_path, parameters_of
from gpgrad_core.pipeline import PairResult, PipelineParams
from gpgrad_core.version import VERSION

STYLE = (
    "body{font:16px/1.5 system-ui,sans-serif;color:#222;background:#fff;margin:2em auto;"
    "max-width:1240px;padding:0 1em}h1{font-size:1.4em;margin:0}img{max-width:100%}"
    "table{border-collapse:collapse}td,th{text-align:left;padding:.1em 1.2em .1em 0;"
    "vertical-align:top;font-variant-numeric:tabular-nums}th{font-weight:400;color:#555}"
    "pre{background:#f3f3f3;padding:.7em;white-space:pre-wrap;overflow-wrap:anywhere}"
    ".changed{font-weight:600}a{overflow-wrap:anywhere}"
)
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
    pair = f"query {escape(state.query_id)}, database {escape(state.database_id)}"
    figures = "".join(_row(row.name, row.value) for row in rows_of(state, result))
    encoded = base64.b64encode(picture).decode("ascii")
    here = f'<h2>Link</h2><p><a href="{escape(link)}">{escape(link)}</a></p>' if link else ""
    by_hand = f"<p>{escape(decided)}</p>" if decided else ""
    title = f"{escape(state.dataset.name)}: {pair}"
    return (
        f'<!doctype html><html lang="en"><meta charset="utf-8"><title>{title}</title>'
        f"<style>{STYLE}</style><h1>{title}</h1>"
        f"<p><b>{escape(headline_of(result, with_score=True))}</b>, threshold "
        f"{number_text(METHODS[state.method].lowest(state.params))}. "
        f"{escape(in_words(state, result))}</p>{by_hand}"
        f"<table>{figures}</table>"
        f'<p><img alt="Both maps, their height difference, and where they agree" '
        f'src="data:image/png;base64,{encoded}"></p>'
        f"<p>Dots are inliers. Grey cells are masked, or were seen by one submap only. The lower "
        f"panels lie in the database's frame. Blue agreement speaks for one terrain, red for "
        f"two.</p>"
        f"<h2>Command</h2><p>This command finds the same inliers, score and motion:</p>"
        f"<pre>{escape(command_of(state))}</pre>{here}"
        f"<h2>Parameters</h2><p>The method is {state.method}. What differs from its own defaults "
        f"is bold.</p>"
        f"<table>{_parameters(state)}</table>"
        f"<p>gpgrad {escape(VERSION)}</p></html>"
    )


def lines_below(state: ViewState, result: PairResult, *, link: str = "", decided: str = "") -> str:
    """Write what stands below the figure of a report that is one picture."""
    figures = " · ".join(f"{row.name} {row.value}" for row in rows_of(state, result))
    changed = [f"{path} {value}" for path, value, differs in _values(state) if differs]
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


def _values(state: ViewState) -> list[tuple[str, str, bool]]:
    """List the parameters: name, value with unit, and whether something else was asked for."""
    base = METHODS[state.method].adapt(PipelineParams())
    found: list[tuple[str, str, bool]] = []
    for field in parameters_of(PipelineParams):
        value, asked = get_path(state.params, field.path), get_path(state.asked, field.path)
        text = f"{value:g}" if type(value) is float else str(value)
        unit = "" if field.bounds is None else f" {field.bounds.unit}".rstrip()
        if asked is None:
            text, unit = ("automatic", "") if value is None else (text, f"{unit}, automatic")
        found.append((field.path, text + unit, asked != get_path(base, field.path)))
    return found


def _parameters(state: ViewState) -> str:
    return "".join(
        f"<tr{' class=changed' if differs else ''}><th>{escape(name)}</th><td>{escape(value)}</td>"
        "</tr>"
        for name, value, differs in _values(state)
    )


def _row(name: str, value: str) -> str:
    return f"<tr><th>{escape(name)}</th><td>{escape(value)}</td></tr>"
