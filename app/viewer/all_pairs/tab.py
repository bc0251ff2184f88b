"""All pairs in the viewer: wires its panel to a runner, and the runner to its pictures."""

import threading
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from app.viewer.all_pairs.curve import curve_svg
from app.viewer.all_pairs.judging import RULES, Judged, Survey, TruthCheck, judge, survey_pairs
from app.viewer.all_pairs.matrix import affinity_svg, highest_color
from app.viewer.all_pairs.panel import AllPairsPanel, Choice, Findings
from app.viewer.feature import Part
from app.viewer.host import Host
from app.viewer.runner import Runner
from app.viewer.state import ViewState
from gpgrad_core.run.memo import Memo
from gpgrad_core.run.progress import Progress

REPORT_EVERY = 0.01
"""Share of the whole by which the progress must grow to be shown anew."""


@dataclass(frozen=True, eq=False)
class _Judging:
    """What the verdicts on all pairs depend on."""

    survey: Survey
    state: ViewState
    rule: str


class AllPairs(Part):
    """Registers all pairs when asked, and judges them anew as the thresholds move."""

    def __init__(
        self,
        host: Host,
        state: ViewState,
        memo: Memo,
        turns: threading.Semaphore,
        *,
        on_pair: Callable[[str, str], None],
        message_of: Callable[[Exception], str],
        on_judged: Callable[[Judged], None] = lambda judged: None,  # noqa: ARG005
        on_progress: Callable[[float | None, str], None] = lambda fraction, message: None,  # noqa: ARG005
    ) -> None:
        """Make the panel in the current container.

        Args:
            host: Whose GUI it joins.
            state: The session as it is.
            memo: Shared with the pair that is shown.
            turns: Of what takes long.
            on_pair: Given the query and the database to show; must be quick.
            message_of: Says what went wrong in one line.
            on_judged: Given all pairs whenever they were judged anew.
            on_progress: Given how far the run is, and None once nothing runs, with why if there
                is something to say.
        """
        self._host = host
        self._tell_judged = on_judged
        self._on_progress = on_progress
        self._memo = memo
        self._message_of = message_of
        self._lock = threading.Lock()
        self._state = state
        self._rule = next(iter(RULES))
        self._survey: Survey | None = None
        self._asked: tuple[object, ...] = ()
        self._panel = AllPairsPanel(
            host,
            tuple(RULES),
            on_run=self.run,
            on_cancel=self.cancel,
            on_rule=self._set_rule,
            on_pair=on_pair,
        )
        self._surveyor: Runner[ViewState, Survey] = Runner(
            self._register,
            self._on_survey,
            self._on_error,
            on_cancel=lambda state: self._stopped("Cancelled."),  # noqa: ARG005
            turns=turns,
            name="all pairs",
        )
        self._judge: Runner[_Judging, Judged] = Runner(
            lambda job, progress: judge(  # noqa: ARG005 - it is over in milliseconds
                job.survey, job.state.params.closure, RULES[job.rule]
            ),
            self._on_judged,
            lambda job, error: self._stopped(message_of(error), bad=True),  # noqa: ARG005
            name="verdicts",
        )

    def follow(self, state: ViewState) -> None:
        """Follow the session: its thresholds, its pair, another dataset. Returns at once."""
        with self._lock:
            other_dataset = state.dataset is not self._state.dataset
            self._state = state
            if other_dataset:
                self._survey = None
        if other_dataset:
            self._surveyor.cancel()
            self._panel.clear()
        self._submit()

    def run(self) -> None:
        """Register all pairs with the parameters as they are; returns at once."""
        self._running(0.0)
        self._surveyor.submit(self._state)

    def cancel(self) -> None:
        """Stop registering."""
        self._surveyor.cancel()

    def wait_idle(self, timeout: float) -> bool:
        """Wait until nothing runs; says whether that came true within the timeout [s]."""
        return self._surveyor.wait_idle(timeout) and self._judge.wait_idle(timeout)

    def close(self) -> None:
        """Stop."""
        self._surveyor.close()
        self._judge.close()

    def _running(self, fraction: float) -> None:
        self._panel.running(fraction)
        self._on_progress(fraction, "")

    def _stopped(self, message: str = "", *, bad: bool = False) -> None:
        self._panel.stopped(message, bad=bad)
        self._on_progress(None, message)

    def _set_rule(self, rule: str) -> None:
        self._rule = rule
        self._submit()

    def _submit(self) -> None:
        """Ask for new verdicts, unless nothing changed that they depend on."""
        with self._lock:
            survey, state = self._survey, self._state
            if survey is None:
                return
            pair = state.query_id, state.database_id
            asked = survey, state.params.closure, pair, self._rule, survey.is_of(state)
            if asked != self._asked:
                self._asked = asked
                self._judge.submit(_Judging(survey, state, self._rule))

    def _register(self, state: ViewState, progress: Progress) -> Survey:
        reported = 0.0

        def report(fraction: float) -> None:
            nonlocal reported
            progress(fraction)
            if fraction - reported >= REPORT_EVERY:
                reported = fraction
                self._running(fraction)

        return survey_pairs(state.dataset, state.params, self._memo, report)

    def _on_survey(self, state: ViewState, survey: Survey, seconds: float) -> None:
        del seconds
        with self._lock:
            if state.dataset is not self._state.dataset:
                return  # another was opened in the very last moment
            self._survey = survey
        self._stopped()
        self._submit()

    def _on_error(self, state: ViewState, error: Exception) -> None:
        del state
        self._stopped(self._message_of(error), bad=True)

    def _on_judged(self, job: _Judging, judged: Judged, seconds: float) -> None:
        del seconds
        if job.survey is not self._survey:
            return
        with self._host.atomic():
            self._panel.show(findings(judged, job.state))
        self._host.flush()
        self._tell_judged(judged)


def findings(judged: Judged, state: ViewState) -> Findings:
    """Put what was judged into pictures and words."""
    survey, count = judged.survey, judged.num_accepted
    seconds = survey.result.seconds["total"]
    closures = "loop closure" if count == 1 else "loop closures"
    ranked = sorted(
        zip(judged.closures, judged.outcomes, strict=True),
        key=lambda pair: -pair[0].registration.score,
    )
    shown = state.query_id, state.database_id
    return Findings(
        summary=f"{count} {closures} in {len(judged.closures):,} pairs · {seconds:.1f} s",
        outdated=""
        if survey.is_of(state)
        else "Found with other parameters than those set now: run again to compare.",
        matrix=affinity_svg(judged, shown),
        matrix_caption=_matrix_caption(judged),
        curve="" if judged.check is None else curve_svg(judged.check),
        curve_caption="" if judged.check is None else _curve_caption(judged.check),
        choices=tuple(
            Choice(closure.query_id, closure.database_id, closure.registration.score, outcome)
            for closure, outcome in ranked
        ),
        shown=shown,
    )


def _matrix_caption(judged: Judged) -> str:
    below = (
        "Row: query, column: database. Below the diagonal: the score, from dark (0) to yellow "
        f"({highest_color(judged):.1f})."
    )
    if judged.check is None:
        return f"{below} Ring: accepted. Magenta: the pair shown."
    measure = "of the boxes" if judged.check.rule.measure == "box" else "of the surfaces"
    return (
        f"{below} Above it: the true overlap {measure}, from dark (0) to light (1). "
        "Ring: green accepted, red wrongly accepted, orange missed. Magenta: the pair shown."
    )


def _curve_caption(check: TruthCheck) -> str:
    if check.curve is None:
        return f"No pair is true by the rule {check.rule.name}: there is nothing to find."
    precision = f"{check.precision:.3f}" if np.isfinite(check.precision) else "—"
    return (
        f"At the thresholds set: precision {precision}, recall {check.recall:.3f} (magenta). "
        f"Average precision {check.average_precision:.3f}. {check.rule.statement}"
    )
