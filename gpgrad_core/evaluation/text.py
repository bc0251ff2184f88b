"""Writes the text and the tables of ``report.md``."""

from collections.abc import Callable, Iterable, Sequence
from math import degrees

import numpy as np

from gpgrad_core.evaluation.judge import Evaluation, MethodVerdict, Ranked, RuleVerdict, Summary
from gpgrad_core.evaluation.pose_error import Bin
from gpgrad_core.evaluation.rules import Labels, Rule
from gpgrad_core.version import VERSION

SHOWN_INLIERS = (1, 2, 3, 4, 5, 6, 8, 10, 12, 15, 20)
UNKNOWN = "n/a"

LEGEND = """\
- **AP**, average precision: the area under the curve of precision over recall.
  **R100**: the largest share of the true pairs that a threshold finds without a false pair.
  **F1**: the largest harmonic mean of precision and recall, and the score at which it is
  reached. Pairs of equal score pass or fail together.
- **placed right**: within {offset:g} m and {turn:g}° of the true motion.
- **grey**: pairs that touch without being true. They often do fit together; *grey, placed
  right* counts the accepted grey pairs whose motion is the true one.
"""
LEGEND_OF_INTERVALS = """\
- **[low, high]**: the interval of 95 % of {resamples} resamples (seed {seed}) of the *submaps*,
  because pairs that share a submap are not independent. R100 depends on a single pair, so its
  interval is rough. A perfect figure is perfect in every resample: [1.00, 1.00] does not mean
  that it is certain.
"""
LEGEND_OF_LEAD = """\
- **lead**: the AP of the first method minus this one's, on the same resamples. If the whole
  interval is above 0, the lead is more than chance.
"""
CAPTIONS = {
    "precision_recall_by_inliers": "Like the paper's Fig. 8: the threshold is n = 1 to 20 inliers.",
    "precision_recall": "Precision over recall of all methods. A star marks what a method accepts.",
    "precision_by_inliers": "Like the paper's Fig. 9: precision and recall against n.",
    "affinity_": "The true overlap of all pairs, and the scores of a method.",
    "loops_": "The loop closures of a method on the true traverse.",
}
"""Captions of figures by the beginning of their names; the first that fits is used."""


def describe(evaluation: Evaluation, figures: Sequence[str]) -> str:
    """Write the text of the report in Markdown.

    Args:
        evaluation: The results to report.
        figures: Names of the pictures beside it, without their ending.
    """
    pairs = evaluation.pairs
    lines = [
        f"# Loop closures on {evaluation.dataset}",
        "",
        f"{len(pairs.ids)} submaps with a true pose, {len(pairs)} pairs; gpgrad {VERSION}.",
        "",
    ]
    if evaluation.notes:
        lines += [*(f"- Note: {note}." for note in evaluation.notes), ""]
    lines += ["## How to read this", "", _legend(evaluation)]
    lines += _describe_accepted(evaluation)
    for k, (rule, labels) in enumerate(zip(evaluation.rules, evaluation.labels, strict=True)):
        verdicts = [(method, method.rules[k]) for method in evaluation.methods]
        lines += _describe_rule(rule, labels, verdicts)
    lines += _describe_times(evaluation.methods)
    lines += ["## Figures", ""]
    for name in figures:
        lines += [_caption(name), "", f"![{name}]({name}.png)", ""]
    return "\n".join(lines)


def _describe_accepted(evaluation: Evaluation) -> list[str]:
    """Describe the accepted pairs by their motion, for which no rule is needed."""
    params = evaluation.params
    rows = [
        (
            method.name,
            f"{method.accepted.count}",
            f"{method.accepted.right}",
            f"{method.accepted.wrong_motion}",
            f"{method.accepted.no_overlap}",
        )
        for method in evaluation.methods
    ]
    header = ("method", "accepted", "right", "wrong motion", "no overlap")
    return [
        "## Accepted loop closures by their motion",
        "",
        f"A loop closure is right if its motion is within {params.max_offset_error:g} m and "
        f"{params.max_turn_error:g}° of the true one. *Wrong motion* counts the other loop "
        "closures whose submaps share ground, and *no overlap* those whose submaps share none.",
        "",
        *([f"*left out: neighbours |i - j| <= {params.neighbours}*", ""] * bool(params.neighbours)),
        *_table(header, rows),
        "",
    ]


def _caption(name: str) -> str:
    return next((text for start, text in CAPTIONS.items() if name.startswith(start)), name)


def _legend(evaluation: Evaluation) -> str:
    params = evaluation.params
    legend, count = LEGEND, params.num_resamples
    legend = legend.format(offset=params.max_offset_error, turn=params.max_turn_error)
    if count:
        legend += LEGEND_OF_INTERVALS.format(resamples=count, seed=evaluation.seed)
    return legend + LEGEND_OF_LEAD if len(evaluation.methods) > 1 else legend


def _describe_rule(
    rule: Rule, labels: Labels, verdicts: Sequence[tuple[MethodVerdict, RuleVerdict]]
) -> list[str]:
    counts = f"{int(np.sum(labels.positive))} true pairs, {int(np.sum(labels.negative))} false" + (
        f", {int(np.sum(labels.grey))} grey" if not rule.count_grey else ""
    )
    short = f"*{rule.name}; {counts}; {_left_out(rule)}*"
    lines = [f"## Judged by {rule.name}", "", rule.statement, f"{counts}.", ""]
    ranked = [(method.name, verdict.ranked) for method, verdict in verdicts if verdict.ranked]
    if ranked:
        lines += ["### Ranking", "", short, "", *_ranking(ranked), ""]
        lines += [
            "### Precision (and recall) with at least n inliers",
            "",
            short,
            "",
            *_by_inliers(ranked),
            "",
        ]
    else:
        lines += ["No pair is true by this rule: there is nothing to rank.", ""]
    lines += ["### What each method accepts, and where it places it", "", short, ""]
    lines += [*_accepted(verdicts), ""]
    what = "box IoU" if rule.measure == "box" else "surface overlap"
    lines += [f"### Touching pairs by {what}: placed right and accepted / accepted / all", ""]
    lines += [f"*{_left_out(rule, grey=False)}*", ""]
    lines += [
        *_bins([(m.name, v.by_overlap) for m, v in verdicts], lambda edge: f"{edge:g}"),
        "",
    ]
    if labels.positive.any():
        lines += ["### True pairs by relative yaw: placed right and accepted / accepted / all", ""]
        lines += [short, ""]
        lines += [
            *_bins([(m.name, v.by_yaw) for m, v in verdicts], lambda edge: f"{degrees(edge):.0f}°"),
            "",
        ]
    return lines


def _left_out(rule: Rule, *, grey: bool = True) -> str:
    what = [f"neighbours |i - j| <= {rule.neighbours}"] if rule.neighbours else []
    if grey and not rule.count_grey:
        what.append("grey pairs")
    return f"left out: {' and '.join(what)}" if what else "nothing is left out"


def _ranking(ranked: Sequence[tuple[str, Ranked]]) -> list[str]:
    several = len(ranked) > 1
    rows = [
        (
            name,
            _summary(one.average_precision),
            _summary(one.recall_at_full_precision),
            _summary(one.f1),
            f"{one.f1_threshold:.3g}",
            f"{one.average_precision_by_inliers:.3f}",
            f"{one.recall_at_full_precision_by_inliers:.3f}",
            *(("first" if one.lead is None else _summary(one.lead, sign=True),) if several else ()),
        )
        for name, one in ranked
    ]
    header = ("method", "AP", "R100", "F1", "at score", "AP by inliers", "R100 by inliers")
    return _table((*header, "lead") if several else header, rows)


def _by_inliers(ranked: Sequence[tuple[str, Ranked]]) -> list[str]:
    rows: list[tuple[str, ...]] = []
    for name, one in ranked:
        both = zip(one.by_inliers.precision, one.by_inliers.recall, strict=True)
        cells = [f"{_share(precision)} ({_share(recall)})" for precision, recall in both]
        rows.append((name, *(cells[n - 1] for n in SHOWN_INLIERS)))
    return _table(("method", *(f"n >= {n}" for n in SHOWN_INLIERS)), rows)


def _accepted(verdicts: Sequence[tuple[MethodVerdict, RuleVerdict]]) -> list[str]:
    rows: list[tuple[str, ...]] = []
    for method, verdict in verdicts:
        errors = verdict.pose_error
        rows.append(
            (
                method.name,
                f"{verdict.accepted_true}",
                f"{verdict.accepted_false}",
                f"{verdict.accepted_grey}",
                f"{verdict.accepted_grey_near}",
                f"{verdict.missed}",
                _centimetres(errors.median_offset),
                _centimetres(errors.high_offset),
                _turned(errors.median_turn),
                _turned(errors.high_turn),
                _percent(errors.near),
                _percent(verdict.near),
            )
        )
    header = (
        *("method", "true", "false", "grey", "grey, placed right", "missed"),
        *("offset, median", "95th percentile", "turn, median", "95th percentile"),
        *("placed right", "placed right of all true"),
    )
    return _table(header, rows)


def _bins(
    methods: Sequence[tuple[str, tuple[Bin, ...]]], spell: Callable[[float], str]
) -> list[str]:
    edges = [f"{spell(one.low)} to {spell(one.high)}" for one in methods[0][1]]
    rows = [
        (name, *(f"{one.accepted_near} / {one.accepted} / {one.pairs}" for one in bins))
        for name, bins in methods
    ]
    return _table(("method", *edges), rows)


def _describe_times(methods: Iterable[MethodVerdict]) -> list[str]:
    stages = ("maps", "features", "pairs", "total")
    rows = [
        (
            method.name,
            *(
                f"{method.ranking.seconds[stage]:.1f}"
                if stage in method.ranking.seconds
                else UNKNOWN
                for stage in stages
            ),
        )
        for method in methods
    ]
    return ["## Time [s]", "", *_table(("method", *stages), rows), ""]


def _table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    lines = [header, ["---", *["---:"] * (len(header) - 1)], *rows]
    return [f"| {' | '.join(one.replace('|', '/') for one in line)} |" for line in lines]


def _summary(summary: Summary, *, sign: bool = False) -> str:
    plus = "+" if sign else ""
    said = f"{summary.value:{plus}.3f}"
    if summary.interval is None:
        return said
    return f"{said} [{summary.interval.low:{plus}.2f}, {summary.interval.high:{plus}.2f}]"


def _share(value: float) -> str:
    return f"{value:.2f}" if np.isfinite(value) else UNKNOWN


def _percent(share: float | None) -> str:
    return UNKNOWN if share is None else f"{100 * share:.1f} %"


def _centimetres(metres: float | None) -> str:
    return UNKNOWN if metres is None else f"{100 * metres:.1f} cm"


def _turned(radians: float | None) -> str:
    return UNKNOWN if radians is None else f"{degrees(radians):.2f}°"
