"""Draws the figures into a folder, and writes the page that shows all of them."""

from collections.abc import Callable, Sequence
from html import escape
from pathlib import Path

from gpgrad_core.evaluation.judge import Evaluation, Summary
from gpgrad_core.evaluation.reproduction.figures import NOT_MADE, PaperFigure, list_figures
from gpgrad_core.evaluation.reproduction.style import in_print, save
from gpgrad_core.evaluation.reproduction.subject import TITLES, Subject
from gpgrad_core.run.progress import Progress, silent
from gpgrad_core.version import VERSION

PAGE = "index.html"
ENDINGS = (".png", ".svg")
STYLE = (
    "body{font:16px/1.5 system-ui,sans-serif;color:#222;background:#fff;margin:2em auto;"
    "max-width:60em;padding:0 1em}h1{font-size:1.5em}h2{font-size:1.2em;margin-top:2.5em}"
    "figure{margin:1em 0}figcaption{max-width:46em}img{max-width:100%;height:auto}"
    "table{border-collapse:collapse}td,th{text-align:left;padding:.1em 1.2em .1em 0;"
    "font-variant-numeric:tabular-nums}"
    "pre{background:#f3f3f3;padding:.7em;white-space:pre-wrap;overflow-wrap:anywhere}"
)
PIXELS_AN_INCH = 110
"""How large a figure is on a screen, by its size on paper."""


def write_figures(
    directory: Path,
    subjects: Sequence[Subject],
    numbers: frozenset[int],
    command: Callable[[frozenset[int]], str],
    progress: Progress = silent,
) -> tuple[str, ...]:
    """Draw all figures that can be made, and write the page.

    Args:
        directory: An existing folder.
        subjects: The datasets, each with what its figures need.
        numbers: Numbers of the wanted figures in the paper.
        command: Gives the command that makes the figures of these numbers.
        progress: Called with the fraction done; may raise Cancelled.

    Returns:
        What is left out and why, one line each.
    """
    figures, notes = list_figures(subjects, numbers)
    widths: dict[str, float] = {}
    for k, figure in enumerate(figures):
        with in_print():
            drawn = figure.draw()
            for ending in ENDINGS:
                save(drawn, directory / f"{figure.name}{ending}")
        widths[figure.name] = float(drawn.get_figwidth())
        progress((k + 1) / len(figures))
    page = _page(subjects, numbers, figures, notes, command, widths)
    (directory / PAGE).write_text(page, encoding="utf-8")
    return tuple(notes)


def _page(
    subjects: Sequence[Subject],
    numbers: frozenset[int],
    figures: Sequence[PaperFigure],
    notes: Sequence[str],
    command: Callable[[frozenset[int]], str],
    widths: dict[str, float],
) -> str:
    datasets = ", ".join(subject.dataset.name for subject in subjects)
    title = f"The paper's figures from {datasets}"
    parts = [
        f'<!doctype html><html lang="en"><meta charset="utf-8"><title>{escape(title)}</title>',
        f"<style>{STYLE}</style><h1>{escape(title)}</h1>",
        "<p>The figures are those of Le Gentil et al., <i>Gaussian Process Gradient Maps for "
        "Loop-Closure Detection in Unstructured Planetary Environments</i> (IROS 2020), made from "
        f"other data. The maps and the loop closures are by the method "
        f"<b>{escape(subjects[0].method.name)}</b>. Each picture leads to its SVG file.</p>",
        f"<p>All of them:</p><pre>{escape(command(numbers))}</pre>",
    ]
    left_out = [*notes, NOT_MADE]
    parts.append("<ul>" + "".join(f"<li>{escape(note)}</li>" for note in left_out) + "</ul>")
    for number in sorted({figure.number for figure in figures}):
        parts.append(f'<h2 id="figure-{number}">Fig. {number}: {escape(TITLES[number])}</h2>')
        parts += [
            _figure(figure, widths[figure.name]) for figure in figures if figure.number == number
        ]
        if number == 8:
            parts.append(_table([one.evaluation for one in subjects if one.evaluation]))
        parts.append(f"<pre>{escape(command(frozenset({number})))}</pre>")
    parts.append(f"<p>gpgrad {escape(VERSION)}</p></html>\n")
    return "\n".join(parts)


def _figure(figure: PaperFigure, width: float) -> str:
    png, svg = (f"{figure.name}{ending}" for ending in ENDINGS)
    return (
        f'<figure><a href="{escape(svg)}"><img src="{escape(png)}" '
        f'width="{width * PIXELS_AN_INCH:.0f}" alt="Fig. {figure.number}: '
        f'{escape(TITLES[figure.number])}"></a>'
        f"<figcaption>{escape(figure.caption)}</figcaption></figure>"
    )


def _table(evaluations: Sequence[Evaluation]) -> str:
    """Write the summary of the curves: a row for each dataset and method."""
    rows = [
        "<tr><th>dataset</th><th>method</th><th>true pairs</th><th>average precision (AP)</th>"
        "<th>recall at 100 % precision</th></tr>"
    ]
    for evaluation in evaluations:
        true = int(evaluation.labels[0].positive.sum())
        for method in evaluation.methods:
            ranked = method.rules[0].ranked
            cells = (
                evaluation.dataset,
                method.name,
                str(true),
                "" if ranked is None else _summary(ranked.average_precision),
                "" if ranked is None else _summary(ranked.recall_at_full_precision),
            )
            rows.append("<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in cells) + "</tr>")
    brackets = "<p>In brackets: intervals of 95 %.</p>" if any("[" in row for row in rows) else ""
    return f"<table>{''.join(rows)}</table>{brackets}"


def _summary(summary: Summary) -> str:
    if summary.interval is None:
        return f"{summary.value:.3f}"
    return f"{summary.value:.3f} [{summary.interval.low:.2f}, {summary.interval.high:.2f}]"
