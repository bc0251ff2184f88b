"""What a session tells its features: its state, and what it knows of a pair, of all, of a drive."""

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Literal, NamedTuple, TypeAlias

from app.viewer.session.decisions import Decisions
from app.viewer.session.session_file import Opened
from app.viewer.session.state import ViewState
from gpgrad_core.detection import DetectionResult, PairResult, PipelineParams
from gpgrad_core.types import GradientMap, PairOfIds

Subject: TypeAlias = Literal["pair", "world"]
"""What the scene shows."""
Mode: TypeAlias = Literal["Explore", "Tune", "Demo"]
"""What the page is for."""

DriveNews: TypeAlias = Literal["drawn", "latest wanted"]
"""That the world is drawn anew, or that all of it is wanted and not what there was at some time."""


@dataclass(frozen=True, eq=False)
class SessionState:
    """Everything that a session is set to; a change makes a new one.

    Attributes:
        view: What pictures are made from.
        opened: What was opened last, if it was told.
        decided: What a person decided about pairs: all of it after each step, the newest last.
        mode: What the page is for.
        subject: What the scene shows.
        moving: Whether a hand is still on the slider of a parameter.
        released: Parameters at which a hand has last let go of one.
        full_screen: Whether all panels are put away.
        left_away: Whether those on the left are.
    """

    view: ViewState
    opened: Opened | None = None
    decided: tuple[Decisions, ...] = (Decisions(),)
    mode: Mode = "Tune"
    subject: Subject = "pair"
    moving: bool = False
    released: PipelineParams | None = None
    full_screen: bool = False
    left_away: bool = False

    @property
    def decisions(self) -> Decisions:
        """All decisions as they are now."""
        return self.decided[-1]

    def opened_since(self, before: "SessionState") -> Opened | None:
        """Give what was opened since another state; None if it is the same."""
        return None if self.opened is before.opened else self.opened


class PairShown(NamedTuple):
    """What the pipeline found for a state; the scene shows it."""

    state: ViewState
    result: PairResult


class SubmapShown(NamedTuple):
    """The map of the one submap there is, which the scene shows; there is no pair."""

    state: ViewState
    gradient_map: GradientMap


class PairMoved(NamedTuple):
    """Whether the query lies where a hand has put it, and is not judged."""

    by_hand: bool


class PairOutdated:
    """What is seen is not what is set: it failed, or was cancelled."""


PairNews: TypeAlias = PairShown | SubmapShown | PairMoved | PairOutdated


class Verdicts(NamedTuple):
    """All pairs as the thresholds judge them.

    Attributes:
        state: With which they were judged; its parameters may be others by now.
        params: Of the comparison and of the verdicts.
        found: The verdicts.
        outcomes: What the truth says of each, where it is known.
    """

    state: ViewState
    params: PipelineParams
    found: DetectionResult = DetectionResult((), {})
    outcomes: Mapping[PairOfIds, str] = MappingProxyType({})


class AllPairs(NamedTuple):
    """What is known of all pairs.

    Attributes:
        fraction: How far their comparison is; None while none runs.
        message: With which the last one ended.
        verdicts: Under the present thresholds; None before any pair was judged.
    """

    fraction: float | None = None
    message: str = ""
    verdicts: Verdicts | None = None
