"""The verdict on the pair: loop closure or not, what spoke for it, and what against it."""

from dataclasses import dataclass
from html import escape
from math import degrees, isfinite, pi
from typing import Literal, TypeAlias

from app.viewer.server.host import Host
from app.viewer.session.decisions import BY_HAND as DECIDED
from app.viewer.session.decisions import Decisions, in_order
from app.viewer.session.state import NEEDS_TWO, ViewState
from app.viewer.widgets.html import (
    BAD,
    BAD_GROUND,
    BUSY_GROUND,
    DATABASE_WORDS,
    FAINT,
    GOOD,
    GOOD_GROUND,
    QUERY_WORDS,
    QUIET,
    badge,
)
from gpgrad_core.detection import PairResult
from gpgrad_core.detection.verdict import (
    ClosureParams,
    RefusalKind,
    describe_length,
    explained,
    find_refusal,
    has_small_overlap,
)
from gpgrad_core.methods.paper import PaperPair
from gpgrad_core.se2 import SE2
from gpgrad_core.types import ImageSays

CLOSURE, NONE = "Loop closure", "No loop closure"
CANNOT, BY_HAND = "Cannot judge", "Moved by hand, not judged"
ALONE = "One submap, no pair"
HEIGHT = 18.25
"""Height of the card [lines of text]: always the same, so that nothing below it ever moves."""
END_OF_BAR = 12.0
"""Score at the end of the bar, which the slider of the threshold ends at too."""
ON_BAR = "inliers n"
"""The row that the bar shows already: the card has no room for it twice."""
END_OF_INLIERS = 40
"""Inliers at the end of the bar, likewise."""
SAYS_SOMETHING = 0.5
"""Evidence that is nearer to zero says nothing."""

Side: TypeAlias = Literal["for", "against", "neither"]
MARKS: dict[Side, str] = {
    "for": f'<span style="color:{GOOD}" title="speaks for a loop closure">▲</span>',
    "against": f'<span style="color:{BAD}" title="speaks against a loop closure">▼</span>',
    "neither": f'<span style="{FAINT}" title="says nothing">○</span>',
}

BY_IMAGES: dict[ImageSays, Side] = {
    "confirmed": "for",
    "contradicted": "against",
    "silent": "neither",
}
SAID: dict[Side, str] = {"for": "agree", "against": "disagree", "neither": "say little"}


@dataclass(frozen=True)
class Row:
    """A figure of the card.

    Attributes:
        side: For what it speaks, shown by a mark; None is no evidence.
        name: Of the figure.
        value: As text, with its unit.
    """

    side: Side | None
    name: str
    value: str


class VerdictCard:
    """A card of fixed height that is rewritten with each result."""

    def __init__(self, host: Host) -> None:
        """Make it in the current container, empty."""
        self._result: tuple[ViewState, PairResult] | None = None
        self._alone = ""  # the one submap there is, where there is no pair
        self._moved, self._stale, self._decisions = False, "", Decisions()
        self._faded = False
        self._handle = host.gui.add_html(frame('<div style="opacity:.7">No result yet.</div>'))

    def show(self, state: ViewState, result: PairResult) -> None:
        """Show a result."""
        self._result, self._alone = (state, result), ""
        self._faded, self._stale = False, ""
        self._write()

    def show_alone(self, state: ViewState) -> None:
        """Say that one submap is no pair, and what is needed for one."""
        self._result, self._alone = None, state.query_id
        self._faded, self._stale = False, ""
        self._write()

    def set_moved(self, moved: bool) -> None:
        """Say whether the query has been moved by hand from where it was judged."""
        if moved != self._moved:
            self._moved = moved
            self._write()

    def decide(self, decisions: Decisions) -> None:
        """Say what a person decided about the pair."""
        self._decisions = decisions
        self._write()

    def outdate(self, why: str = "") -> None:
        """Fade the card, because it is not about the present picture.

        Args:
            why: Written on it; empty while a new one is coming.
        """
        self._faded, self._stale = True, why
        self._write()

    def _write(self) -> None:
        if self._alone:
            self._handle.content = alone_html(self._alone, faded=self._faded, stale=self._stale)
        elif self._result is not None:
            state, result = self._result
            self._handle.content = verdict_html(
                state,
                result,
                moved=self._moved,
                faded=self._faded,
                stale=self._stale,
                decided=self._decisions.verdicts.get(
                    in_order(state.dataset, state.query_id, state.database_id)
                ),
            )


def headline_of(result: PairResult, *, with_score: bool = False) -> str:
    """Give the verdict in a word or two, and the score if there is one and it is wanted."""
    if result.registration.nothing_trusted:
        return CANNOT
    verdict = CLOSURE if result.closure.accepted else NONE
    if not with_score:
        return verdict
    if isinstance(result, PaperPair):
        return f"{verdict} · n = {result.registration.num_inliers}"
    return f"{verdict} · score {result.registration.score:.1f}"


def verdict_html(
    state: ViewState,
    result: PairResult,
    *,
    moved: bool = False,
    faded: bool = False,
    stale: str = "",
    decided: bool | None = None,
) -> str:
    """Write the card.

    Args:
        state: What was judged.
        result: What was found.
        moved: Whether the query no longer lies where it was judged.
        faded: Whether the card is not about the present picture.
        stale: Why it is not; empty while a new one is coming.
        decided: What a person decided about the pair, if anybody did.
    """
    closure = result.closure
    headline = BY_HAND if moved else headline_of(result)
    ground = {CLOSURE: GOOD_GROUND, NONE: BAD_GROUND}.get(headline, BUSY_GROUND)
    by_hand = "" if decided is None or moved else DECIDED[decided]
    note = _note("stale", stale) if stale else _note("decided", by_hand) if by_hand else ""
    pair = (
        f'<b><span style="color:{QUERY_WORDS}">query {escape(closure.query_id)}</span> → '
        f'<span style="color:{DATABASE_WORDS}">database {escape(closure.database_id)}</span></b>'
    )
    inside = (
        f'<div style="{ONE_LINE};margin:.4em 0 .3em">{pair}</div>'
        f"{_bar(state, result)}"
        f'<div title="{escape(closure.reason)}" style="height:2.7em;overflow:hidden;'
        f'line-height:1.35;margin:.35em 0">{escape(in_words(state, result))}</div>'
        f"{_table([row for row in rows_of(state, result) if row.name != ON_BAR])}"
    )
    dim = "opacity:.4" if faded or moved else ""
    return frame(
        f"{badge(headline, ground, 'verdict')}{note}"
        f'<div style="font-size:.85em;{dim}">{inside}</div>'
    )


def alone_html(submap_id: str, *, faded: bool = False, stale: str = "") -> str:
    """Write the card of one submap, which has no pair."""
    note = _note("stale", stale) if stale else ""
    dim = ";opacity:.4" if faded else ""
    return frame(
        f"{badge(ALONE, BUSY_GROUND, 'verdict')}{note}"
        f'<div style="font-size:.85em;line-height:1.45{dim}"><div style="{ONE_LINE};'
        f'margin:.4em 0"><b>submap {escape(submap_id)}</b></div>{escape(NEEDS_TWO)}</div>'
    )


def _note(test_id: str, text: str) -> str:
    """Write a word on the headline's ground, at its right."""
    return (
        f'<div data-testid="{test_id}" style="position:absolute;right:1.3em;top:.55em;'
        "font-size:.8em;padding:.15em .5em;border-radius:.3em;background:#fff;color:#6b3f00"
        f'">{escape(text)}</div>'
    )


ONE_LINE = "white-space:nowrap;overflow:hidden;text-overflow:ellipsis"


def _bar(state: ViewState, result: PairResult) -> str:
    """Draw the score as a bar, and the threshold as a tick on it."""
    needed = state.params.closure
    name, score, lowest, end, digits = (
        (ON_BAR, result.registration.num_inliers, needed.min_inliers, END_OF_INLIERS, 0)
        if isinstance(result, PaperPair)
        else ("score", result.registration.score, needed.min_score, END_OF_BAR, 1)
    )
    share, tick = (100 * min(value / end, 1.0) for value in (score, lowest))
    color = GOOD_GROUND if score >= lowest else BAD_GROUND
    of_all = f" of {len(result.matches):,}" if isinstance(result, PaperPair) else ""
    named = name[:1].upper() + name[1:]
    return (
        f'<div data-testid="score" role="img" aria-label="{named} {score:.{digits}f}, threshold '
        f'{lowest:.{digits}f}"><div style="display:flex;justify-content:space-between"><span>'
        f"{name} <b>{score:.{digits}f}</b>{of_all}</span>"
        f"<span>threshold {lowest:.{digits}f}</span></div>"
        '<div style="position:relative;height:12px;margin-top:4px;border-radius:3px;'
        'background:light-dark(#dcdcdc,#4a4a4a)"><div style="position:absolute;left:0;top:0;'
        f'bottom:0;width:{share:.1f}%;border-radius:3px;background:{color}"></div>'
        f'<div style="position:absolute;left:{tick:.1f}%;top:-4px;bottom:-4px;width:3px;'
        "margin-left:-1.5px;background:light-dark(#111,#fff);outline:1px solid "
        'light-dark(#fff,#111)"></div></div></div>'
    )


DISSIMILAR = "The gradients of the two maps differ too much under the motion (h)."
WORDS: dict[RefusalKind, str] = {
    "nothing trusted": "The variance mask hides all ground of one submap. Raise it to see more.",
    "no motion": "No motion was found: the maps have too little in common.",
    "few inliers": "Too few associations agree with the motion.",
    "no common ground": "The maps share too little ground to compare.",
    "too little ground": "The maps share too little ground to compare.",
    "heights differ": "The heights differ by more than the uncertainty of the maps allows.",
    "small overlap": "The maps agree, but share too little ground to decide.",
    "smooth ground": "The ground is too smooth to decide.",
    "chance": "The maps agree, but unrelated ground can agree as well.",
}
"""What decided, without the figures that stand beside it. Other refusals give their reason."""
WORDS_OF_PAPER: dict[RefusalKind, str] = {
    "no motion": "No motion was found: no two associations agree with one.",
    "few inliers": "Too few associations agree with the motion (n).",
    "dissimilar": DISSIMILAR,
    "dissimilar cells": DISSIMILAR,
}
"""The same by the paper's two thresholds, on n and on h."""


def in_words(state: ViewState, result: PairResult) -> str:
    """Say what decided, without the figures that stand beside it."""
    needed, closure = state.params.closure, result.closure
    of_paper = isinstance(result, PaperPair)
    refusal = None if closure.accepted else find_refusal(result.registration, needed)
    words = WORDS_OF_PAPER if of_paper else WORDS
    if refusal is not None and refusal.kind in words:
        return words[refusal.kind]
    if not closure.accepted:
        return closure.reason[:1].upper() + closure.reason[1:] + "."
    by_h = not _no_limit(needed) if of_paper else needed.min_score > 0
    if not by_h and needed.min_inliers == 0:
        return "No threshold is set, so every motion is accepted."
    if not of_paper:
        return "Both submaps show one terrain, as far as their ground can tell."
    with_h = ", and their gradients differ little enough (h)" if by_h else ""
    return f"Enough associations agree with the motion (n){with_h}."


def rows_of(state: ViewState, result: PairResult) -> list[Row]:
    """List the evidence, and then the motion."""
    if isinstance(result, PaperPair):
        return paper_rows(state, result)
    registration = result.registration
    found, scale, motion = (
        registration.agreement,
        registration.scale,
        registration.T_database_query,
    )
    inliers, *bands = registration.evidence or (0.0,)
    rows = [
        Row(
            _side(share),
            f"{name} waves",
            f"{SAID[_side(share)]} ({share:+z.1f}), {first * 2 * pi * scale:.1f} to "
            f"{2 * first * 2 * pi * scale:.1f} m",
        )
        for name, first, share in zip(("short", "long"), (1, 2), bands, strict=False)
        if scale is not None
    ]
    needed = state.params.closure.min_inliers
    count = f"{registration.num_inliers} of {len(result.matches):,}"
    if needed:
        count = f"{registration.num_inliers} (threshold {needed}) of {len(result.matches):,}"
    too_few = registration.num_inliers < needed
    rows.append(
        Row(
            "against" if too_few else _side(inliers),
            "inliers",
            count + (f" ({inliers:+z.1f})" if registration.evidence else ""),
        )
    )
    if found is not None:
        rows.append(
            Row(
                "against" if found.difference > explained(found) else "for",
                "heights differ",
                f"{describe_length(found.difference)}, up to {describe_length(explained(found))} "
                "explained",
            )
        )
    if (images := result.closure.images) is not None:
        count = f"{images.num_inliers} of {images.num_associations:,} fit"
        rows.append(Row(BY_IMAGES[images.verdict], "images", f"{images.verdict}, {count}"))
    if motion is None:
        return [*rows, Row(None, "motion", "none found")]
    area = f"{registration.overlap_area:.1f} m² · correlation {registration.correlation:z.2f}"
    return [
        *rows,
        Row("against" if has_small_overlap(registration) else "for", "overlap", area),
        Row(None, "motion", _motion_text(motion)),
    ]


def _motion_text(motion: SE2) -> str:
    return f"{motion.x:+z.2f} m, {motion.y:+z.2f} m, {degrees(motion.yaw):+z.1f}°"


def _no_limit(needed: ClosureParams) -> bool:
    return needed.max_dissimilarity is None and needed.max_mean_dissimilarity is None


def paper_rows(state: ViewState, result: PaperPair) -> list[Row]:
    """List n and h with their thresholds, the motion, and what was fitted to each submap."""
    registration, needed = result.registration, state.params.closure
    count = registration.num_inliers
    rows = [
        Row(
            "for" if count >= needed.min_inliers else "against",
            ON_BAR,
            f"{count} (at least {needed.min_inliers}) of {len(result.matches):,} associations",
        )
    ]
    for name, value, limit in (
        ("h", registration.dissimilarity, needed.max_dissimilarity),
        ("h of a cell", registration.mean_dissimilarity, needed.max_mean_dissimilarity),
    ):
        side: Side | None = None if limit is None else "for" if value <= limit else "against"
        allowed = "no limit" if limit is None else f"at most {limit:.3g}"
        found = f"{value:.3g} ({allowed}) 1/m⁴" if isfinite(value) else "none: no common ground"
        rows.append(Row(side, name, found))
    motion = registration.T_database_query
    rows.append(Row(None, "motion", "none found" if motion is None else _motion_text(motion)))
    asked = state.asked.map
    for name, field, given in (
        ("length-scale", "length_scale", asked.length_scale),
        ("noise", "noise_std", asked.noise_std),
        ("signal", "signal_std", asked.signal_std),
    ):
        of_query, of_database = (
            _length(getattr(terrain, field))
            for terrain in (result.query_terrain, result.database_terrain)
        )
        text = f"{of_query} query, {of_database} database"
        rows.append(Row(None, name, text if given is None else f"{of_query}, as it is set"))
    return rows


def _length(metres: float | None) -> str:
    """Write a fitted length; without one, it is that of the points."""
    return "the points' own" if metres is None else describe_length(metres)


def _side(evidence: float) -> Side:
    if abs(evidence) < SAYS_SOMETHING:
        return "neither"
    return "for" if evidence > 0 else "against"


def _table(rows: list[Row]) -> str:
    lines = "".join(
        f'<tr><td style="width:1.2em">{"" if row.side is None else MARKS[row.side]}</td>'
        f'<td style="padding-right:.6em;white-space:nowrap;color:{QUIET}">{escape(row.name)}</td>'
        f'<td style="white-space:nowrap;font-variant-numeric:tabular-nums">{escape(row.value)}</td>'
        "</tr>"
        for row in rows
    )
    return (
        f'<table style="border-collapse:collapse;font-size:.94em;line-height:1.45">{lines}</table>'
    )


def frame(content: str) -> str:
    """Give a card its margin and its height."""
    return (
        f'<div style="position:relative;box-sizing:border-box;height:{HEIGHT}em;overflow:hidden;'
        f'padding:.2em .75em .4em">{content}</div>'
    )
