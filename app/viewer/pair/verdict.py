"""The verdict on the pair: loop closure or not, why, and the numbers behind it."""

from html import escape
from math import degrees

from app.viewer.host import Host
from app.viewer.state import ViewState
from app.viewer.widgets.html import BAD_GROUND, BUSY_GROUND, GOOD_GROUND, badge, table
from gpgrad_core.loop_closure import describe_length
from gpgrad_core.pipeline import PairResult
from gpgrad_core.types import Registration


class VerdictCard:
    """A card that is rewritten with each result."""

    def __init__(self, host: Host) -> None:
        """Make it in the current container, empty."""
        self._card = frame('<div style="opacity:.7">No result yet.</div>')
        self._handle = host.gui.add_html(self._card)

    def show(self, state: ViewState, result: PairResult) -> None:
        """Show a result."""
        self._card = verdict_html(state, result)
        self._handle.content = self._card

    def outdate(self, why: str = "") -> None:
        """Fade the card, because it is not about the present picture.

        Args:
            why: Written above it; empty while a new one is coming.
        """
        above = (
            f'<div style="padding:0 .75em">{badge(why, BUSY_GROUND, "stale")}</div>' if why else ""
        )
        self._handle.content = f'{above}<div style="opacity:.4">{self._card}</div>'


def verdict_html(state: ViewState, result: PairResult) -> str:
    """Write the card."""
    closure, registration = result.closure, result.registration
    needed, lowest = state.params.closure.min_inliers, state.params.closure.min_score
    motion = registration.T_database_query
    rows = [
        ("inliers", f"{registration.num_inliers}" + (f" (threshold {needed})" if needed else "")),
        ("associations", f"{len(result.matches):,}"),
        ("score", f"{registration.score:.1f}" + (f" (threshold {lowest:g})" if lowest else "")),
    ]
    if motion is not None:
        rows += [
            ("yaw", f"{degrees(motion.yaw):+.1f}°"),
            ("offset", f"{motion.x:+.2f} m, {motion.y:+.2f} m"),
            ("overlap", f"{registration.overlap_area:.1f} m²"),
            ("correlation", f"{registration.correlation:.2f}"),
        ]
        rows += _comparison(registration)
    else:
        rows.append(("motion", "none found"))
    headline = (
        badge("Loop closure", GOOD_GROUND, "verdict")
        if closure.accepted
        else badge("No loop closure", BAD_GROUND, "verdict")
    )
    pair = f"query {closure.query_id} → database {closure.database_id}"
    if closure.query_id == closure.database_id:
        pair += " (the same submap twice)"
    return frame(
        f"{headline}"
        f'<div style="font-size:.85em;margin:.4em 0 .3em"><b>{escape(pair)}</b><br>'
        f"{escape(closure.reason)}</div>{table(tuple(rows))}"
    )


def _comparison(registration: Registration) -> list[tuple[str, str]]:
    """List at which scale the maps were compared, and how well they agree there."""
    agreement, scale = registration.agreement, registration.scale
    if agreement is None or scale is None:
        return []
    difference = describe_length(agreement.difference)
    possible = describe_length(agreement.possible)
    return [("heights differ", f"{difference} at {scale:.2f} m ({possible} possible)")]


def frame(content: str) -> str:
    """Give a card its margin."""
    return f'<div style="padding:.2em .75em .4em">{content}</div>'
