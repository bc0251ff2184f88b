"""What camera images say of the closures that the terrain found, against the truth."""

from collections.abc import Mapping
from typing import get_args

from gpgrad_core.evaluation.judge import Evaluation
from gpgrad_core.evaluation.report import Section
from gpgrad_core.outputs import ClosureReport
from gpgrad_core.types import ImageSays


def describe_images(
    reports: Mapping[str, ClosureReport], evaluation: Evaluation
) -> tuple[Section, ...]:
    """Count by the truth what images say, as a section of the report.

    Args:
        reports: What each method found, by its name.
        evaluation: How it was judged; its first rule says which pairs are true.

    Returns:
        The section; none if no method asked images.
    """
    pairs, labels, rule = evaluation.pairs, evaluation.labels[0], evaluation.rules[0]
    rows = {
        frozenset((pairs.ids[query], pairs.ids[database])): k
        for k, (query, database) in enumerate(zip(pairs.query, pairs.database, strict=True))
    }
    content: dict[str, dict[str, dict[str, int]]] = {}
    for name, report in reports.items():
        counts = {word: {"true": 0, "false": 0, "left_out": 0} for word in get_args(ImageSays)}
        for pair in report.pairs:
            row = rows.get(frozenset((pair.query, pair.database)))
            if pair.images is None or row is None:
                continue
            true, false = bool(labels.positive[row]), bool(labels.negative[row])
            truth = "true" if true else "false" if false else "left_out"
            counts[pair.images.verdict][truth] += 1
        if any(number for one in counts.values() for number in one.values()):
            content[name] = counts
    if not content:
        return ()
    lines = [
        "## Images",
        "",
        "What camera images say of the pairs that the terrain accepted, before they refuse any. "
        f"True and false are by the first rule, {rule.name}, which leaves some pairs out.",
        "",
        "| method | images | true | false | left out |",
        "| --- | --- | ---: | ---: | ---: |",
    ]
    for name, counts in content.items():
        lines += [
            f"| {name.replace('|', '/')} | {word} | {one['true']} | {one['false']} "
            f"| {one['left_out']} |"
            for word, one in counts.items()
        ]
    return (Section("images", content, "\n".join([*lines, ""])),)
