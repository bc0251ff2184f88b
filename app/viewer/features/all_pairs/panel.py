"""All pairs of the dataset: run, look at the matrix and the curve, and pick a pair to see."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from html import escape

import viser

from app.viewer.server.host import Host
from app.viewer.session.methods import METHODS
from app.viewer.session.state import ViewState
from app.viewer.widgets.actions import on_choice
from app.viewer.widgets.html import BUSY, FAINT, box, make_solid, message_line, paragraph
from app.viewer.widgets.pair_list import PairList
from app.viewer.widgets.status import WorkBar
from gpgrad_core.detection import PipelineParams
from gpgrad_core.detection.shortlist import ALL_UP_TO, DEFAULT_CANDIDATES, Candidate, Candidates
from gpgrad_core.detection.verdict import ClosureParams
from gpgrad_core.params import get_path, parameters_of
from gpgrad_core.types import PairOfIds

RUN: str = "Run all pairs"
NO_CHOICE: str = "choose a pair …"
ALL: str = "all"
CANDIDATES: dict[str, Candidates] = {
    "automatic": "automatic",
    "all earlier ones": "all",
    "the 5 best": 5,
    "the 10 best": 10,
    "the 30 best": 30,
    "the 100 best": 100,
}
"""By their names, how many earlier submaps a submap can be compared with."""


@dataclass(frozen=True)
class Findings:
    """What the panel shows of all pairs at the thresholds as they are.

    Attributes:
        html: Pictures and texts, by their `PLACES`; those that are missing are empty.
        choices: All pairs with what became of each in words, by label; the best come first.
        shown: (query, database) that the scene shows.
        has_truth: Whether the truth is known, by one rule or another.
    """

    html: Mapping[str, str]
    choices: Mapping[str, tuple[PairOfIds, str]]
    shown: tuple[str, str]
    has_truth: bool


PLACES = ("summary", "matrix", "block", "key", "scores", "disagreements", "curve", "threshold")
"""Pictures and texts from above to below; the one called "reasons" stands below the list."""


class AllPairsPanel:
    """Widgets for all pairs; ``html`` is what is shown, by its place."""

    def __init__(
        self, host: Host, rules: tuple[str, ...], on_pair: Callable[[str, str], None]
    ) -> None:
        """Make the widgets in the current container, with the names of the rules to choose from."""
        gui = host.gui
        self._choices: Mapping[str, tuple[PairOfIds, str]] = {}
        intro = "Compare every submap with earlier ones, using the present parameters."
        gui.add_html(paragraph(intro, FAINT))
        self.candidates_choice: viser.GuiDropdownHandle[str] = gui.add_dropdown(
            "Compare with",
            tuple(CANDIDATES),
            initial_value=next(iter(CANDIDATES)),
            hint="With how many earlier submaps each submap is compared. Automatic takes all of up "
            f"to {ALL_UP_TO} earlier ones, and up to {DEFAULT_CANDIDATES} promising ones of more.",
        )
        self.run = gui.add_button(RUN, hint="You can use the sliders while it runs.")
        make_solid(host, self.run)
        self.work_bar = WorkBar(host, "Cancel", "all-pairs", starts=(self.run,))
        self._anew = gui.add_html("")
        self._parameters = gui.add_html("")
        self.html = {place: gui.add_html("") for place in PLACES}
        self.rule = gui.add_dropdown(
            "True if",
            rules,
            initial_value=rules[0],
            visible=False,
            hint="By which rule the true poses say that a pair shows the same place. A pair that "
            "touches without being true is left out: its motion may still be right.",
        )
        self._narrow: viser.GuiDropdownHandle[str] = gui.add_dropdown(
            "List",
            (ALL,),
            initial_value=ALL,
            visible=False,
            hint="Narrows the list below. Right pairs are accepted, and their motion is right. "
            "Missed pairs are the same place by the rule, but refused.",
        )
        self._pairs = PairList(
            host,
            "Pair",
            none=NO_CHOICE,
            hint="Shows the pair. The highest score comes first: query → database · score · "
            "outcome.",
            on_choose=lambda pair: None if pair is None else on_pair(*pair),
        )
        self._pairs.set_visible(False)
        self.html["reasons"] = gui.add_html("")
        on_choice(self._narrow, lambda _: self._list(self._pairs.chosen))

    @property
    def candidates(self) -> Candidates:
        """With how many earlier submaps a submap is to be compared."""
        return CANDIDATES[self.candidates_choice.value]

    def offer(self, counts: str, *, same: bool) -> None:
        """Say what the button does.

        Args:
            counts: How many pairs of how many an unfinished run has; empty if there is none.
            same: Whether that run has the parameters as they are.
        """
        self.run.label = f"Resume ({counts} pairs done)" if counts and same else RUN
        anew = f"Other parameters: a run starts anew ({counts} pairs were done with those below)."
        self._anew.content = (
            message_line("all-pairs-anew", anew, BUSY) if counts and not same else ""
        )

    def show_run(self, content: str) -> None:
        """Show the parameters of the run, as HTML that is safe."""
        self._parameters.content = content

    def clear(self) -> None:
        """Clear everything, because another dataset is open."""
        self.show(Findings({}, {}, ("", ""), has_truth=False))
        self.show_run("")
        self.work_bar.idle()

    def show(self, findings: Findings) -> None:
        """Show what was found."""
        for place, handle in self.html.items():
            content = findings.html.get(place, "")
            if handle.content != content:  # else a page would draw it anew, even under the hand
                handle.content = content
        self._choices = findings.choices
        outcomes = {outcome for _, outcome in findings.choices.values()}
        self._narrow.options = (ALL, *sorted(outcomes))
        self._narrow.visible = bool(findings.choices)
        self._pairs.set_visible(bool(findings.choices))
        self.rule.visible = findings.has_truth
        self._list(findings.shown)

    def _list(self, chosen: tuple[str, str] | None) -> None:
        """Fill the list with the outcome that it is narrowed to."""
        narrow = self._narrow.value
        listed = {
            label: pair
            for label, (pair, outcome) in self._choices.items()
            if narrow in (ALL, outcome)
        }
        self._pairs.offer(listed, chosen)


def summary_html(summary: str, outdated: str) -> str:
    """Write what was found in a line, and why it should be found anew, if it should."""
    note = message_line("all-pairs-message", outdated, BUSY)
    return paragraph(summary, "font-weight:600") + note


def run_html(state: ViewState, candidates: Candidates) -> str:
    """Write what a run was asked for, which opens on a click: what moves later is not part of it.

    Thresholds are left out, because pairs are judged by the present ones.
    """
    method = METHODS[state.method]
    given, usual = state.given, method.registered_by(state.given)
    listed = [
        f"{field.path} {_in_words(get_path(given, field.path))}"
        for field in parameters_of(PipelineParams)
        if field.path not in method.unused
        and (not field.path.startswith("closure.") or usual.closure != ClosureParams())
    ]
    compared = next(name for name, value in CANDIDATES.items() if value == candidates)
    title = f"Parameters of this run: method {state.method}, compared with {compared}"
    return folded(title, " · ".join(listed))


def _in_words(value: object) -> str:
    return (
        "automatic" if value is None else f"{value:.4g}" if isinstance(value, float) else f"{value}"
    )


def folded(title: str, text: str) -> str:
    """Write plain text that a click on its title opens."""
    return (
        f'<details style="padding:.2em .75em;font-size:.85em"><summary style="cursor:pointer">'
        f'{escape(title)}</summary><div style="line-height:1.45;{FAINT}">{escape(text)}</div>'
        "</details>"
    )


def shortlist_html(
    query: str, database: str, shortlist: tuple[Candidate, ...], num_earlier: int
) -> str:
    """Write the shortlist of a query as a table that opens on a click: why a pair was looked at.

    The best come first; it is empty if the query was compared with all earlier submaps.
    """
    if not shortlist:
        return ""
    ids = [candidate.id for candidate in shortlist]
    place = (
        f"{database} is number {ids.index(database) + 1} among"
        if database in ids
        else f"{database} is not among them, so this pair was not compared. They are"
    )
    lead = (
        f"{query} was compared with {len(shortlist)} of {num_earlier:,} earlier submaps. {place} "
        "the candidates whose keypoints fit best: by votes, which are associations that keep "
        "their distances, and by the similarity of all descriptors."
    )
    look = "padding-left:1em;text-align:right;font-weight:inherit"
    has_vectors = any(candidate.similarity for candidate in shortlist)  # few submaps have none
    head = "".join(
        f'<th style="{FAINT};{look}">{heading}</th>'
        for heading in ("", "submap", "votes", "similarity")
    )
    rows = ""
    for number, candidate in enumerate(shortlist, start=1):
        similarity = f"{candidate.similarity:.2f}" if has_vectors else "—"
        cells = (str(number), candidate.id, str(candidate.votes), similarity)
        weight = "font-weight:700" if candidate.id == database else ""
        row = "".join(f'<td style="{look}">{escape(cell)}</td>' for cell in cells)
        rows += f'<tr style="{weight}">{row}</tr>'
    return box(
        "shortlist",
        '<details><summary style="cursor:pointer">Why was this pair looked at?</summary>'
        f'<div style="line-height:1.45;margin:.3em 0">{escape(lead)}</div>'
        f'<table style="border-collapse:collapse;font-variant-numeric:tabular-nums">'
        f'<tr style="font-weight:400">{head}</tr>{rows}</table></details>',
        "font-size:.85em",
    )
