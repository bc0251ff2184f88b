"""The verdict on the pair: a card that stays in sight, its evidence, and figures, which unfold."""

import threading
from collections.abc import Iterator
from dataclasses import dataclass
from html import escape
from math import degrees, inf, isfinite, pi
from typing import Any, Literal, TypeAlias

from app.viewer.server.host import Host
from app.viewer.session.decisions import BY_HAND as DECIDED
from app.viewer.session.decisions import Decisions
from app.viewer.session.state import NEEDS_TWO, ViewState, same_pair, same_verdict
from app.viewer.web import fill_page_file
from app.viewer.widgets.html import (
    AMBER_GROUND,
    BAD,
    BAD_GROUND,
    BUSY_GROUND,
    FAINT,
    GOOD,
    GOOD_GROUND,
    GREY_GROUND,
    QUIET,
)
from gpgrad_core.detection import PairResult
from gpgrad_core.detection.verdict import (
    RULES,
    describe_length,
    ground_in_words,
    has_small_overlap,
    heights_fit,
    heights_in_words,
    keypoints_in_words,
    rule_of,
    why_of,
)
from gpgrad_core.errors import score_in_words, told_apart
from gpgrad_core.methods.paper import PaperPair
from gpgrad_core.types import Context, ImageSays, LoopClosure, Registration

BY_HAND = "Moved by hand, not judged"
ACCEPTED, REFUSED = (DECIDED[accepted].capitalize() for accepted in (True, False))
CHECK, CROSS = "M4.5 12.5l5 5L19.5 7", "M6 6l12 12M18 6L6 18"
QUESTION = "M8.5 9a3.5 3.5 0 1 1 5.2 3c-1.1.7-1.7 1.4-1.7 2.8M12 18.4v.1"
MOVED, WAITING = "M12 4v16M4 12h16M9 7l3-3 3 3M9 17l3 3 3-3", "M6 12h.1M12 12h.1M18 12h.1"
LOOKS = {
    "Loop closure": (GOOD_GROUND, CHECK),
    ACCEPTED: (GOOD_GROUND, CHECK),
    "No loop closure": (BAD_GROUND, CROSS),
    REFUSED: (BAD_GROUND, CROSS),
    "Undecided": (AMBER_GROUND, QUESTION),
    "Cannot judge": (AMBER_GROUND, QUESTION),
    BY_HAND: (BUSY_GROUND, MOVED),
}
"""The ground of each headline, while it is of the present picture, and the path of its icon."""
LONG_HEADLINE = 18
"""Characters: a longer one has smaller letters."""
FIGURES_HEIGHT = 10.6
"""Height of the figures [lines of text]: always the same, so that nothing below them moves."""
END_OF_BAR = 12.0
"""Score at the end of the bar, which the slider of the threshold ends at too."""
ON_BAR = "inliers n"
"""The figure that the bar of the card shows already."""
IN_BAR = "score"
"""The sentence that it shows."""
END_OF_INLIERS = 40
"""Inliers at the end of the bar, likewise."""
SAYS_SOMETHING = 0.5
"""Evidence that is nearer to zero says nothing."""
NEAR = 0.15
"""A score is near its threshold within this share of it, and far from it beyond twice or half."""
JUST_SEEN = 0.05
"""A smaller change of the score is not visible in its digits."""

Stance: TypeAlias = Literal["for", "against", "neither"]
MARKS: dict[Stance, str] = {
    "for": f'<span style="color:{GOOD}" title="speaks for a loop closure">▲</span>',
    "against": f'<span style="color:{BAD}" title="speaks against a loop closure">▼</span>',
    "neither": f'<span style="{FAINT}" title="says nothing">○</span>',
}

BY_IMAGES: dict[ImageSays, Stance] = {
    "confirmed": "for",
    "contradicted": "against",
    "silent": "neither",
}


@dataclass(frozen=True)
class Finding:
    """What was compared: a sentence of the card, or a figure below it."""

    side: Stance | None  # for what it speaks, shown by a mark; None is no evidence
    # A sentence begins small and has no full stop, as in the reason of the verdict; a figure has
    # its unit.
    text: str
    name: str = ""  # of a figure


def whole_sentence(text: str) -> str:
    """A sentence with its capital letter and its full stop.

    >>> whole_sentence("they share 92 m²")
    'They share 92 m².'
    """
    return f"{text[:1].upper()}{text[1:]}."


class VerdictCard:
    """A card of fixed height that is rewritten with each result, and its figures."""

    def __init__(self, host: Host) -> None:
        self._shown_for: tuple[ViewState, PairResult | None] | None = None  # no result of no pair
        self._moved, self._stale, self._decisions = False, "", Decisions()
        self._faded = False
        self._lock = threading.RLock()  # a timer may fade it while a result comes
        host.gui.add_html(f"<style>{fill_page_file('verdict.css')}</style>")
        self._handle = host.gui.add_html(card_html("No result yet", GREY_GROUND))
        self._folder = host.gui.add_folder("Figures", expand_by_default=False)
        with self._folder:
            self._figures = host.gui.add_html(framed(""))

    @property
    def visible(self) -> bool:
        return self._handle.visible

    @visible.setter
    def visible(self, visible: bool) -> None:
        self._handle.visible = self._folder.visible = visible

    def show(self, state: ViewState, result: PairResult | None, *, coming: str = "") -> None:
        """Show a result, or that one submap is no pair.

        It is grey if another is coming, and says what is done for that.
        """
        with self._lock:
            self._shown_for = state, result
            self._faded, self._stale = False, coming
            self._write()

    def set_moved(self, moved: bool) -> None:
        with self._lock:
            if moved != self._moved:
                self._moved = moved
                self._write()

    def decide(self, decisions: Decisions) -> None:
        with self._lock:
            self._decisions = decisions
            self._write()

    def wait_for(self, state: ViewState) -> None:
        """Fade the card unless it tells what a state asks for; of another pair nothing stays."""
        with self._lock:
            if self._shown_for is not None and not same_pair(self._shown_for[0], state):
                self._shown_for = None
            if self._shown_for is None or not same_verdict(self._shown_for[0], state):
                self.outdate("computing …")

    def outdate(self, why: str) -> None:
        """Fade the card, because it is not about the present picture, and say why."""
        with self._lock:
            self._faded, self._stale = True, why
            self._write()

    def _write(self) -> None:
        state, result = self._shown_for or (None, None)
        look: dict[str, Any] = {"faded": self._faded, "stale": self._stale}
        figures = framed("")
        if state is None:
            card = card_html("No result yet", GREY_GROUND, stale=self._stale)
        elif result is None:
            headline = f"Submap {state.query_id}, no pair"
            card = card_html(headline, BUSY_GROUND, NEEDS_TWO, **look)
        else:
            decided = self._decisions.verdicts.get(state.compared_pair)
            card = verdict_html(state, result, moved=self._moved, decided=decided, **look)
            faded = self._faded or self._moved
            figures = figures_html(state, result, faded=faded, grey=bool(self._stale))
        self._handle.content, self._figures.content = card, figures


def headline_of(
    result: PairResult, *, with_score: bool = False, decided: bool | None = None
) -> str:
    """The verdict in a word or two, and the score if there is one, on ``with_score``.

    A person's decision overrides the verdict of the ground.
    """
    if decided is not None:
        return ACCEPTED if decided else REFUSED
    verdict = result.closure.headline
    if not with_score or result.registration.nothing_trusted:
        return verdict
    if isinstance(result, PaperPair):
        return f"{verdict} · n = {result.registration.num_inliers}"
    return f"{verdict} · score {score_in_words(result.registration.score)}"


def verdict_html(
    state: ViewState,
    result: PairResult,
    *,
    moved: bool = False,
    faded: bool = False,
    stale: str = "",
    decided: bool | None = None,
) -> str:
    """Write the card; what a person decided about the pair, if anybody did, comes first.

    It says if the query no longer lies where it was judged; for the rest see `card_html`.
    """
    headline = BY_HAND if moved else headline_of(result, decided=decided)
    lines = "".join(
        f"<p>{_mark(sentence.side)}<span>{escape(whole_sentence(sentence.text))}</span></p>"
        for sentence in sentences_of(state, result)
        if sentence.name != IN_BAR
    )
    ground, icon = LOOKS[headline]
    return card_html(
        headline,
        ground,
        in_words(state, result, decided=decided),
        lines,
        icon=icon,
        bar="" if result.registration.nothing_trusted else _bar(state, result),
        title=result.closure.reason,
        faded=faded,
        dim=moved,
        stale=stale,
    )


def card_html(
    headline: str,
    ground: str,
    why: str = "",
    sentences: str = "",
    *,
    icon: str = WAITING,
    bar: str = "",
    title: str = "",
    faded: bool = False,
    dim: bool = False,
    stale: str = "",
) -> str:
    """Write a card: verdict, score and what decided on its ground, and other sentences below.

    The ground stays at the top of the panel while the rest scrolls. Sentences and bar are HTML that
    is safe, and the title is shown where the pointer rests on what decided. A card that is not
    about the present picture is faded and grey; one that is ``stale`` says why, or what is still
    done for it. All but the headline is faint if it is dim.
    """
    faint = _look(dim=faded or dim, grey=bool(stale))
    ground = GREY_GROUND if faded or stale else ground
    note = f'<span data-testid="stale">{escape(stale)}</span>' if stale else ""
    small = ' class="small"' if len(headline) > LONG_HEADLINE else ""
    return (
        f'<div data-testid="card"><div class="pinned"><div class="ground" style="{ground}">'
        f'<div data-testid="verdict"{small}><svg viewBox="0 0 24 24"><path d="{icon}"/></svg>'
        f'<span>{escape(headline)}</span></div>{note}<div style="{faint}">{bar}'
        f'<div data-testid="why" title="{escape(title)}">{escape(why)}</div></div></div></div>'
        f'<div data-testid="evidence" style="{faint}">{sentences}</div></div>'
    )


def _look(*, dim: bool, grey: bool) -> str:
    """The style of what is not the present verdict: its marks and bars have no colour."""
    return "filter:grayscale(1);" * (dim or grey) + "opacity:.4" * dim


def figures_html(
    state: ViewState, result: PairResult, *, faded: bool = False, grey: bool = False
) -> str:
    """Write the figures: the evidence, and the motion."""
    faint = _look(dim=faded, grey=grey)
    rows = [row for row in figures_of(state, result) if row.name != ON_BAR]
    return framed(
        f'<div style="{faint}">{_table(rows)}<div style="white-space:nowrap;overflow:hidden;'
        f"text-overflow:ellipsis;{FAINT};"
        f'margin-top:.2em">{escape(says_alone(state, result))}</div></div>'
    )


def _mark(side: Stance | None) -> str:
    return f'<span style="flex:0 0 1em">{"" if side is None else MARKS[side]}</span>'


def _bar(state: ViewState, result: PairResult) -> str:
    """Draw the score on a scale with its threshold; what is short of that is hatched."""
    needed = state.params.closure
    name, score, lowest, end, form = (
        (ON_BAR, result.registration.num_inliers, needed.min_inliers, END_OF_INLIERS, ".0f")
        if isinstance(result, PaperPair)
        else ("score", result.registration.score, needed.min_score, END_OF_BAR, ".1f")
    )
    share, tick = (100 * min(value / end, 1.0) for value in (score, lowest))
    has, needs = told_apart(score, lowest, form, form)
    place = f", {where(score, lowest)} the threshold of {needs}" if lowest else "; no threshold"
    words = f"{name[:1].upper()}{name[1:]} {has}{place}"
    reached = "reached" if score >= lowest else "short"
    return (
        f'<div data-testid="score" role="img" aria-label="{words}" style="--score:{share:.1f}%;'
        f'--needed:{tick:.1f}%"><i class="{reached}"></i><b></b></div><div>{words}</div>'
    )


def where(score: float, lowest: float) -> str:
    """How a score compares to its threshold.

    >>> where(9.5, 3.0), where(3.2, 3.0), where(2.9, 3.0), where(1.0, 3.0), where(4.0, 3.0)
    ('far above', 'just above', 'just below', 'far below', 'above')
    """
    side = "above" if score >= lowest else "below"
    if abs(score - lowest) <= NEAR * lowest:
        return f"just {side}"
    return f"far {side}" if score >= 2 * lowest or score <= lowest / 2 else side


def in_words(state: ViewState, result: PairResult, *, decided: bool | None = None) -> str:
    """The verdict's reason, with the rule if it compares numbers; other figures are beside it.

    Where a person decided, that is the verdict by the ground alone.
    """
    if decided is not None:
        return f"By the ground alone: {headline_of(result)}. {in_words(state, result)}"
    closure = result.closure
    return _why_accepted(state, result) if closure.accepted else _why_refused(closure)


def _why_refused(closure: LoopClosure) -> str:
    refusal = closure.refusal
    if refusal is None:
        return whole_sentence(closure.reason)
    # The rule of a low score stands below.
    rule = rule_of(refusal) if "{" in RULES.get(refusal.kind, "") else ""
    return " ".join(whole_sentence(text) for text in (rule, why_of(refusal)) if text)


def _why_accepted(state: ViewState, result: PairResult) -> str:
    needed, context = state.params.closure, result.closure.context
    has_limit = (needed.max_dissimilarity, needed.max_mean_dissimilarity) != (None, None)
    by_h = has_limit if isinstance(result, PaperPair) else needed.min_score > 0
    if not by_h and needed.min_inliers == 0:
        return "No threshold is set, so every motion is accepted."
    if context is not None and context.own_score < needed.min_score:
        own, score = (
            score_in_words(value, needed.min_score) for value in (context.own_score, context.score)
        )
        return f"Other closures lead to the same motion (score {own} alone, {score} with them)."
    if any(sentence.side == "against" for sentence in sentences_of(state, result)):
        return "Both submaps show the same place; what speaks against it weighs less."
    return "Both submaps show the same place."


def sentences_of(state: ViewState, result: PairResult) -> list[Finding]:
    """What was compared: heights, keypoints, ground; and the score, or the paper's h and n."""
    registration, needed = result.registration, state.params.closure
    least = f"; at least {needed.min_inliers} are needed" if needed.min_inliers else ""
    words = keypoints_in_words(registration.num_inliers) + least
    keypoints = Finding(_side_of_inliers(state, result), words)
    if registration.T_database_query is None:
        return [Finding(None, "no motion was found that lays one onto the other"), keypoints]
    area, by_paper = registration.overlap_area, isinstance(result, PaperPair)
    words = ground_in_words(area) if area > 0 else "they share no ground"
    ground = Finding(None if by_paper else _side_of_overlap(registration), words)
    if by_paper:
        side, h, most = _weigh(registration.dissimilarity, needed.max_dissimilarity)
        allowed = f"at most {most} is allowed" if most else "no limit is set"
        words = f"gradients differ by h = {h} 1/m⁴; {allowed}"
        if not isfinite(registration.dissimilarity):
            side, words = None, "gradients cannot be compared"
        return [keypoints, Finding(side, words), ground]
    heights = Finding(None, "heights cannot be compared on so little ground")
    if (agreement := registration.agreement) is not None:
        side = "for" if heights_fit(agreement) else "against"
        heights = Finding(side, heights_in_words(agreement))
    reached = registration.score >= needed.min_score
    has, needs = told_apart(registration.score, needed.min_score, ".1f")
    does = f" {'reaches' if reached else 'is below'} the minimum of {needs}"
    words = f"score {has}{does if needed.min_score else '; no minimum is set'}"
    return [heights, keypoints, ground, Finding("for" if reached else "against", words, IN_BAR)]


def figures_of(state: ViewState, result: PairResult) -> list[Finding]:
    """List the evidence, and then the motion."""
    registration = result.registration
    motion, found = registration.T_database_query, "none found"
    if motion is not None:
        yaw = degrees(motion.yaw)
        found = f"{motion.x:+z.2f} m, {motion.y:+z.2f} m, {yaw:+z.1f}°"
    if isinstance(result, PaperPair):
        printed = _printed_figures(state, result)
        return [*printed, Finding(None, found, "motion"), *_fitted_figures(state, result)]
    scale, (inliers, *bands) = registration.scale, registration.evidence or (0.0,)
    rows = [
        Finding(
            _side(share),
            f"{first * 2 * pi * scale:.1f} to {2 * first * 2 * pi * scale:.1f} m, "
            f"evidence {share:+z.1f}",
            "waves",
        )
        for first, share in zip((1, 2), bands, strict=False)
        if scale is not None
    ]
    least = state.params.closure.min_inliers
    count = f"{registration.num_inliers} of {len(result.matches):,}"
    count += f" (at least {least})" if least else ""
    count += f", evidence {inliers:+z.1f}" if registration.evidence else ""
    rows.append(Finding(_side_of_inliers(state, result), count, "inliers"))
    if (context := result.closure.context) is not None:
        rows.append(_figure_of_others(context, state.params.closure.min_score))
    if (images := result.closure.images) is not None:
        fit = f"{images.verdict}, {images.num_inliers} of {images.num_associations:,} fit"
        rows.append(Finding(BY_IMAGES[images.verdict], fit, "images"))
    if motion is not None:
        area = f"{registration.overlap_area:.1f} m²"
        rows.append(Finding(_side_of_overlap(registration), area, "overlap"))
        rows.append(Finding(None, f"{registration.correlation:z.2f}", "correlation"))
    return [*rows, Finding(None, found, "motion")]


def _side_of_inliers(state: ViewState, result: PairResult) -> Stance:
    registration = result.registration
    if registration.num_inliers < state.params.closure.min_inliers:
        return "against"
    inliers, *_ = registration.evidence or (0.0,)
    return "for" if isinstance(result, PaperPair) else _side(inliers)


def _side_of_overlap(registration: Registration) -> Stance:
    return "against" if has_small_overlap(registration) else "for"


def _weigh(value: float, limit: float | None) -> tuple[Stance | None, str, str]:
    """What the paper's h speaks for, its digits, and those of the most allowed, if any."""
    most, has = told_apart(inf if limit is None else limit, value, least_form=".3g")
    if limit is None:
        return None, has, ""
    return "for" if value <= limit else "against", has, most


def _figure_of_others(context: Context, least: float) -> Finding:
    change = context.score - context.own_score
    side: Stance = "neither" if abs(change) < JUST_SEEN else "for" if change > 0 else "against"
    does = {"for": "raise", "against": "lower", "neither": "leave"}[side]
    own, score = (score_in_words(value, least) for value in (context.own_score, context.score))
    new = "as it is" if side == "neither" else f"to {score}"
    return Finding(side, f"{does} the score {own} {new}", "other pairs")


def says_alone(state: ViewState, result: PairResult) -> str:
    """A note that the other pairs were not compared, and how to compare them; empty if needless."""
    could_ask = len(state.dataset.submaps) > 2 and state.params.closure.others != "off"
    if not could_ask or result.registration.agreement is None or result.closure.context is not None:
        return ""
    if state.compared_pair != (state.query_id, state.database_id):
        return "Judged alone: swap the two to ask others."
    return "Judged alone: All pairs asks the others."


def _printed_figures(state: ViewState, result: PaperPair) -> Iterator[Finding]:
    registration, needed = result.registration, state.params.closure
    least, total = needed.min_inliers, len(result.matches)
    n = f"{registration.num_inliers} (at least {least}) of {total:,} associations"
    yield Finding(_side_of_inliers(state, result), n, ON_BAR)
    for name, value, limit in (
        ("h", registration.dissimilarity, needed.max_dissimilarity),
        ("h of a cell", registration.mean_dissimilarity, needed.max_mean_dissimilarity),
    ):
        side, has, most = _weigh(value, limit)
        text = f"{has} ({f'at most {most}' if most else 'no limit'}) 1/m⁴"
        yield Finding(side, text if isfinite(value) else "none: no common ground", name)


def _fitted_figures(state: ViewState, result: PaperPair) -> Iterator[Finding]:
    terrains = result.query_terrain, result.database_terrain
    for name, field in (
        ("length-scale", "length_scale"),
        ("noise", "noise_std"),
        ("signal", "signal_std"),
    ):
        query, database = (_length(getattr(terrain, field)) for terrain in terrains)
        is_set = getattr(state.asked.map, field) is not None
        text = f"{query}, as it is set" if is_set else f"{query} query, {database} database"
        yield Finding(None, text, name)


def _length(metres: float | None) -> str:
    """Write a fitted length; without one, it is that of the points."""
    return "the points' own" if metres is None else describe_length(metres)


def _side(evidence: float) -> Stance:
    if abs(evidence) < SAYS_SOMETHING:
        return "neither"
    return "for" if evidence > 0 else "against"


def _table(rows: list[Finding]) -> str:
    lines = "".join(
        f'<tr><td style="width:1.2em">{"" if row.side is None else MARKS[row.side]}</td>'
        f'<td style="padding-right:.6em;white-space:nowrap;color:{QUIET}">{escape(row.name)}</td>'
        f'<td style="font-variant-numeric:tabular-nums">{escape(row.text)}</td>'
        "</tr>"
        for row in rows
    )
    return (
        f'<table style="border-collapse:collapse;font-size:12px;line-height:1.45">{lines}</table>'
    )


def framed(content: str) -> str:
    """The figures with their margin, font size and height."""
    return (
        f'<div data-testid="figures" style="box-sizing:border-box;height:{FIGURES_HEIGHT}em;'
        'overflow:hidden;padding:.2em .75em .3em"><div style="font-size:13px;line-height:1.35">'
        f"{content}</div></div>"
    )
