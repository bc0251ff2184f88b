"""What a session tells its features: its state, and what it knows of a pair, of all, of a drive."""

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Literal, NamedTuple, TypeAlias

from app.viewer.session.decisions import Decisions
from app.viewer.session.session_file import Keyframe, Opened
from app.viewer.session.state import Subject, ViewState
from gpgrad_core.detection import DetectionResult, PairResult, PipelineParams
from gpgrad_core.types import GradientMap, PairOfIds

Mode: TypeAlias = Literal["Explore", "Tune", "Demo"]
"""What the page is for."""

DriveNews: TypeAlias = Literal["drawn", "latest wanted"]
"""The world is drawn anew, or its latest state is to be shown and not a past one."""


@dataclass(frozen=True, eq=False)
class SessionState:
    """Everything that a session is set to; a change makes a new one."""

    view: ViewState  # what pictures show
    opened: Opened | None = None  # the last one, if any
    decided: tuple[Decisions, ...] = (Decisions(),)  # all of it after each step, the newest last
    mode: Mode = "Tune"
    subject: Subject = "pair"
    moving: bool = False  # a hand is still on the slider of a parameter
    released: PipelineParams | None = None  # where a hand has last let go of one
    full_screen: bool = False  # all panels are put away
    left_away: bool = False  # those on the left are
    board: bool = False  # the matrix of all pairs stands beside the picture
    keyframes: tuple[Keyframe, ...] = ()  # of a demonstration; without any, the story of the pair

    @property
    def decisions(self) -> Decisions:
        return self.decided[-1]

    def opened_since(self, before: "SessionState") -> Opened | None:
        """What was opened since another state; None if it is the same."""
        return None if self.opened is before.opened else self.opened


class PairShown(NamedTuple):
    """The result of the pipeline for a state; the scene shows it."""

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
    """What is shown is not what is set: it failed, or was cancelled."""


PairNews: TypeAlias = PairShown | SubmapShown | PairMoved | PairOutdated


class Verdicts(NamedTuple):
    """All pairs as the thresholds judge them."""

    state: ViewState  # with which they were judged; its parameters may be others by now
    params: PipelineParams  # of the comparison and of the verdicts
    found: DetectionResult = DetectionResult((), {})
    outcomes: Mapping[PairOfIds, str] = MappingProxyType({})  # by the truth, if there is one


class AllPairs(NamedTuple):
    """The state of all pairs."""

    fraction: float | None = None  # how far their comparison is; None while none runs
    message: str = ""  # with which the last one ended
    verdicts: Verdicts | None = None  # under the present thresholds; None before there were any
    so_far: Verdicts | None = None  # the same of a run that has not ended
