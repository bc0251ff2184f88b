"""The All pairs tab: wires its panel to a worker that registers all pairs, and one that judges."""

import threading
from dataclasses import dataclass

import numpy as np

from app.viewer.all_pairs.curve import curve_svg
from app.viewer.all_pairs.judging import (
    NO_OVERLAP,
    RIGHT,
    RULES,
    WRONG_MOTION,
    ComparedPairs,
    JudgedPairs,
    TruthCheck,
    compare_pairs,
    judge,
)
from app.viewer.all_pairs.matrix import affinity_svg, highest_color
from app.viewer.all_pairs.panel import AllPairsPanel, Choice, Findings
from app.viewer.all_pairs.reasons import shortlist_html
from app.viewer.feature import Desk, Feature
from app.viewer.runner import Runner
from app.viewer.state import ViewState
from app.viewer.work import Work, message_of
from gpgrad_core.evaluation.pose_error import MAX_OFFSET, MAX_TURN
from gpgrad_core.run.progress import Progress


@dataclass(frozen=True, eq=False)
class _Judging:
    """What the verdicts on all pairs depend on."""

    compared: ComparedPairs
    state: ViewState
    rule: str


class AllPairsTab(Feature):
    """Registers all pairs when asked, and judges them anew as the thresholds move."""

    def __init__(self, desk: Desk) -> None:
        """Make the panel in the current container."""
        self._desk = desk
        self._lock = threading.Lock()
        self._state = desk.state
        self._rule = next(iter(RULES))
        self._compared: ComparedPairs | None = None
        self._asked: tuple[object, ...] = ()
        self._panel = AllPairsPanel(
            desk.host,
            tuple(RULES),
            on_run=self.compare_pairs,
            on_rule=self._set_rule,
            on_pair=desk.choose,
        )
        self._comparer: Work[ViewState, ComparedPairs] = Work(
            self._panel.work_bar,
            lambda _: "Running all pairs",
            self._compare,
            self._on_compared,
            slots=desk.capacity.long,
            name="all pairs",
            watch=lambda fraction, message: desk.tell(Feature.comparing, fraction, message),
        )
        self._judge: Runner[_Judging, JudgedPairs] = Runner(
            _judge,
            self._on_judged,
            lambda _, error: self._panel.work_bar.failed(message_of(error)),
            name="verdicts",
        )
        self.workers = (self._comparer, self._judge)

    def follow(self, state: ViewState) -> None:
        """Follow the session: its thresholds, its pair, another dataset."""
        with self._lock:
            other_dataset = state.dataset is not self._state.dataset
            self._state = state
            if other_dataset:
                self._compared = None
        if other_dataset:
            self._comparer.cancel()
            self._panel.clear()
        self._submit()

    def compare_pairs(self) -> None:
        """Register all pairs with the parameters as they are; returns at once."""
        self._comparer.start(self._state)

    def stop_comparing(self) -> None:
        """Stop registering."""
        self._comparer.cancel()

    def _set_rule(self, rule: str) -> None:
        self._rule = rule
        self._submit()

    def _submit(self) -> None:
        """Ask for new verdicts, unless nothing changed that they depend on."""
        with self._lock:
            compared, state = self._compared, self._state
            if compared is None:
                return
            pair = state.query_id, state.database_id
            asked = compared, state.params.closure, pair, self._rule, compared.is_of(state)
            if asked != self._asked:
                self._asked = asked
                self._judge.submit(_Judging(compared, state, self._rule))

    def _compare(self, state: ViewState, progress: Progress) -> ComparedPairs:
        return compare_pairs(
            state.dataset, state.params, self._desk.memo, progress, self._panel.candidates
        )

    def _on_compared(self, state: ViewState, compared: ComparedPairs, seconds: float) -> None:
        del seconds
        with self._lock:
            if state.dataset is not self._state.dataset:
                return  # another was opened in the very last moment
            self._compared = compared
        self._submit()

    def _on_judged(self, job: _Judging, judged: JudgedPairs, seconds: float) -> None:
        del seconds
        if job.compared is not self._compared:
            return
        host = self._desk.host
        with host.atomic():
            self._panel.show(findings(judged, job.state))
        host.flush()
        self._desk.tell(Feature.judged, job.state.dataset, judged.closures)


def _judge(job: _Judging, progress: Progress) -> JudgedPairs:
    del progress  # it is over in milliseconds
    return judge(job.compared, job.state.params.closure, RULES[job.rule])


def findings(judged: JudgedPairs, state: ViewState) -> Findings:
    """Turn the judged pairs into pictures and words."""
    compared, count = judged.compared, judged.num_accepted
    seconds = compared.result.seconds["total"]
    closures = "loop closure" if count == 1 else "loop closures"
    skipped = f" ({judged.num_skipped:,} were not compared)" if judged.num_skipped else ""
    ranked = sorted(
        zip(judged.closures, judged.outcomes, strict=True),
        key=lambda pair: -pair[0].registration.score,
    )
    shown = state.query_id, state.database_id
    shortlist = compared.result.shortlists.get(state.query_id, ())
    earlier = next(
        (k for k, one in enumerate(compared.dataset.submaps) if one.id == state.query_id), 0
    )
    by_motion = "" if judged.check is None else f": {_by_motion(judged)}"
    return Findings(
        summary=f"{count} {closures} in {len(judged.closures):,} pairs{skipped}{by_motion} · "
        f"{seconds:.1f} s",
        outdated=""
        if compared.is_of(state)
        else "The parameters have changed since: run again to update.",
        matrix=affinity_svg(judged, shown),
        matrix_caption=_matrix_caption(judged),
        curve="" if judged.check is None else curve_svg(judged.check),
        curve_caption="" if judged.check is None else _curve_caption(judged.check),
        choices=tuple(
            Choice(closure.query_id, closure.database_id, closure.registration.score, outcome)
            for closure, outcome in ranked
        ),
        shown=shown,
        reasons=shortlist_html(*shown, shortlist, earlier),
    )


def _by_motion(judged: JudgedPairs) -> str:
    """Count the accepted pairs by what the truth says of them."""
    return ", ".join(
        f"{judged.outcomes.count(outcome)} {name}"
        for outcome, name in (
            (RIGHT, "right"),
            (WRONG_MOTION, "with a wrong motion"),
            (NO_OVERLAP, "without overlap"),
        )
    )


def _matrix_caption(judged: JudgedPairs) -> str:
    below = (
        "Rows are queries, columns are the database. Below the diagonal is the score, from dark "
        "(0) "
        f"to yellow ({highest_color(judged):.1f})."
    )
    if judged.check is None:
        return f"{below} Rings mark accepted pairs, magenta the pair shown."
    measure = "of the boxes" if judged.check.rule.measure == "box" else "of the surfaces"
    return (
        f"{below} Above it is the true overlap {measure}, from dark (0) to light (1). "
        "Rings mark accepted pairs: green ones have the right motion, within "
        f"{MAX_OFFSET:g} m and {MAX_TURN:g}°, red ones a wrong motion, and white ones no common "
        "ground. Orange rings mark missed pairs; magenta marks the pair shown."
    )


def _curve_caption(check: TruthCheck) -> str:
    if check.curve is None:
        return f"No pair is true by the rule {check.rule.name}, so there is nothing to find."
    precision = f"{check.precision:.3f}" if np.isfinite(check.precision) else "—"
    return (
        f"At the present thresholds, precision is {precision} and recall {check.recall:.3f} "
        "(magenta). "
        f"Average precision {check.average_precision:.3f}. {check.rule.statement}"
    )
