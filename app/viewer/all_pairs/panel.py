"""All pairs of the dataset: run, look at the matrix and the curve, and pick a pair to see."""

from collections.abc import Callable
from dataclasses import dataclass
from html import escape

import viser

from app.viewer.host import Host
from app.viewer.widgets.actions import on_choice, on_press
from app.viewer.widgets.html import BUSY, FAINT, message_line, paragraph
from app.viewer.widgets.look import make_solid
from app.viewer.widgets.pair_list import PairList
from app.viewer.widgets.work_bar import WorkBar
from gpgrad_core.shortlist import ALL_UP_TO, DEFAULT_CANDIDATES, Candidates

INTRODUCTION = "Compare every submap with earlier ones, using the present parameters."
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
class Choice:
    """A pair that can be picked.

    Attributes:
        query: Id of the query submap.
        database: Id of the database submap.
        score: What it is ranked by.
        outcome: What became of it, in words; what the list can be narrowed to.
    """

    query: str
    database: str
    score: float
    outcome: str

    @property
    def label(self) -> str:
        """Text of the list's entry."""
        return f"{self.query} → {self.database} · {self.score:.1f} · {self.outcome}"


@dataclass(frozen=True)
class Findings:
    """What the panel shows of all pairs at the thresholds as they are.

    Attributes:
        summary: One line.
        outdated: Why the pairs should be compared again; empty while they need not.
        matrix: Picture of the scores, as HTML.
        block: The same of the block that the shown pair is in; empty where there are no blocks.
        matrix_caption: What its colours and marks mean.
        scores: Histogram and curve, as HTML that does not depend on the threshold.
        disagreements: Marks of the wrong and the missed pairs, as HTML; empty without truth.
        threshold: What brings the threshold of the pages to its value, as HTML.
        curve_caption: The figures that go with the curve; empty without truth.
        choices: All pairs, best first.
        shown: (query, database) that the scene shows.
        reasons: Why that pair was compared, as HTML; empty if all pairs were.
    """

    summary: str
    outdated: str
    matrix: str
    block: str
    matrix_caption: str
    scores: str
    disagreements: str
    threshold: str
    curve_caption: str
    choices: tuple[Choice, ...]
    shown: tuple[str, str]
    reasons: str = ""


class AllPairsPanel:
    """Widgets for all pairs; callbacks run in the server's event loop and must be quick."""

    def __init__(
        self,
        host: Host,
        rules: tuple[str, ...],
        *,
        on_run: Callable[[], None],
        on_rule: Callable[[str], None],
        on_pair: Callable[[str, str], None],
    ) -> None:
        """Make the widgets in the current container.

        Args:
            host: Whose GUI they join.
            rules: Names of the rules by which a pair is truly the same place.
            on_run: Called when all pairs are asked for.
            on_rule: Given the name of the rule chosen.
            on_pair: Given the query and the database to show.
        """
        gui = host.gui
        self._choices: tuple[Choice, ...] = ()
        gui.add_html(paragraph(INTRODUCTION, FAINT))
        self._candidates: viser.GuiDropdownHandle[str] = gui.add_dropdown(
            "Compare with",
            tuple(CANDIDATES),
            initial_value=next(iter(CANDIDATES)),
            hint="With how many earlier submaps each submap is compared. Automatic takes all of up "
            f"to {ALL_UP_TO} earlier ones, and the {DEFAULT_CANDIDATES} most promising of more.",
        )
        run = gui.add_button("Run all pairs", hint="You can use the sliders while it runs.")
        make_solid(host, run)
        self.work_bar = WorkBar(host, "Cancel", "all-pairs", starts=(run,))
        self._summary = gui.add_html("")
        self._matrix = gui.add_html("")
        self._block = gui.add_html("")
        self._matrix_caption = gui.add_html("")
        self._scores = gui.add_html("")
        self._disagreements = gui.add_html("")
        self._curve = gui.add_html("")
        self._threshold = gui.add_html("")
        self._rule = gui.add_dropdown(
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
        self._reasons = gui.add_html("")

        on_press(run, on_run)
        on_choice(self._rule, on_rule)
        on_choice(self._narrow, lambda _: self._list(self._pairs.chosen))

    @property
    def candidates(self) -> Candidates:
        """With how many earlier submaps a submap is to be compared."""
        return CANDIDATES[self._candidates.value]

    def clear(self) -> None:
        """Clear everything, because another dataset is open."""
        self._choices = ()
        for html in (
            self._summary,
            self._matrix,
            self._block,
            self._matrix_caption,
            self._scores,
            self._disagreements,
            self._curve,
            self._threshold,
            self._reasons,
        ):
            html.content = ""
        self._narrow.visible = self._rule.visible = False
        self._pairs.set_visible(False)
        self.work_bar.idle()

    def show(self, findings: Findings) -> None:
        """Show what was found."""
        note = message_line("all-pairs-message", findings.outdated, BUSY)
        self._summary.content = paragraph(findings.summary, "font-weight:600") + note
        for html, content in (
            (self._matrix, findings.matrix),
            (self._block, findings.block),
            (self._matrix_caption, _folded("How to read it", findings.matrix_caption)),
            (self._scores, findings.scores),
            (self._disagreements, findings.disagreements),
            (self._curve, paragraph(findings.curve_caption, FAINT)),
            (self._threshold, findings.threshold),
            (self._reasons, findings.reasons),
        ):
            if html.content != content:  # else a page would draw it anew, even under the hand
                html.content = content
        self._choices = findings.choices
        outcomes = tuple(dict.fromkeys(choice.outcome for choice in findings.choices))
        self._narrow.options = (ALL, *sorted(outcomes))
        self._narrow.visible = bool(findings.choices)
        self._pairs.set_visible(bool(findings.choices))
        self._rule.visible = bool(findings.curve_caption)
        self._list(findings.shown)

    def _list(self, chosen: tuple[str, str] | None) -> None:
        """Fill the list with the outcome that it is narrowed to."""
        narrow = self._narrow.value
        self._pairs.offer(
            {
                choice.label: (choice.query, choice.database)
                for choice in self._choices
                if narrow in (ALL, choice.outcome)
            },
            chosen,
        )


def _folded(title: str, text: str) -> str:
    """Write plain text that a click on its title opens."""
    return (
        f'<details style="padding:.2em .75em;font-size:.85em"><summary style="cursor:pointer">'
        f'{escape(title)}</summary><div style="line-height:1.45;{FAINT}">{escape(text)}</div>'
        "</details>"
    )
