"""The features of the viewer and their desk: what a feature may ask, and what it is told.

A feature is a tab or a tool. It knows its session by one object, the desk. It reads the present
state there and asks for changes there; the desk tells all features of whatever happens. What one
feature does for another is a call: the session hands it over as one of the narrow protocols
below. So no feature needs to know another.
"""

import threading
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Literal, Protocol, TypeAlias, TypeVar, runtime_checkable

import viser

from app.viewer.server.host import Host
from app.viewer.server.limits import READ_ALL, Permissions
from app.viewer.session.decisions import Decisions
from app.viewer.session.methods import METHODS, MethodName
from app.viewer.session.runner import Capacity, Worker
from app.viewer.session.session_file import Opened, SavedSession
from app.viewer.session.state import (
    Camera,
    Probe,
    Role,
    ViewOptions,
    ViewState,
    neighbour,
    same_pair,
    with_fitted,
    with_match,
    with_method,
    with_options,
    with_pair,
    with_params,
    with_probe,
)
from app.viewer.widgets.bridge import Bridge
from app.viewer.widgets.canvas import Canvases
from app.viewer.widgets.numbers import Numbers
from gpgrad_core.detection import DetectionResult, PairResult, PipelineParams
from gpgrad_core.detection.pairs import PHASES as DETECTION_PHASES
from gpgrad_core.errors import InputError
from gpgrad_core.run import Progress
from gpgrad_core.run.memo import Memo
from gpgrad_core.types import Dataset, GradientMap, PairOfIds

Subject: TypeAlias = Literal["pair", "world"]
"""What the scene shows."""
Mode: TypeAlias = Literal["Explore", "Tune", "Demo"]
"""What the page is for."""

TRUTH_SHARE, FIT_SHARE = 0.03, 0.07
"""Parts of the progress that the truth and the fit of the parameters take."""
PHASES: dict[str, float] = {
    "measuring the truth": TRUTH_SHARE,
    "fitting parameters": TRUTH_SHARE + FIT_SHARE,
    **{
        name: TRUTH_SHARE + FIT_SHARE + (1.0 - TRUTH_SHARE - FIT_SHARE) * end
        for name, end in DETECTION_PHASES.items()
    },
}
"""The fraction at which each phase of comparing all pairs ends; see `Feature.comparing`."""


class Feature:
    """Everything that may reach a feature; each overrides what concerns it.

    All of it must be quick: what takes longer than a few milliseconds belongs to a `Runner` of
    the feature's own.
    """

    # What happens.

    def follow(self, state: ViewState) -> None:
        """Take the new state of the session; called at every change of anything."""

    def opened(self, opened: Opened) -> None:
        """Take what was opened; `follow` was called with its first state before."""

    def show(self, state: ViewState, result: PairResult) -> None:
        """Take what the pipeline found for a state, after the scene has shown it."""

    def on_single_submap(self, state: ViewState, gradient_map: GradientMap, /) -> None:
        """Take the map of the one submap there is, after the scene has shown it: there is no pair.

        It comes in place of `show`.
        """

    def moved(self, by_hand: bool) -> None:
        """Take whether the query of the pair lies where a hand has put it, and is not judged."""

    def comparing(self, fraction: float | None, message: str, /) -> None:
        """Take how far the comparison of all pairs is; None once it ended, with the reason."""

    def judged(self, dataset: Dataset, found: DetectionResult, params: PipelineParams, /) -> None:
        """Take all pairs of a dataset, as the present thresholds judge them.

        Args:
            dataset: Whose pairs.
            found: The verdicts.
            params: Of the comparison and of the verdicts. The present ones may be others by now.
        """

    def on_slider_released(self, params: PipelineParams) -> None:
        """Take at which parameters a hand has let go of what it moved."""

    def outdated(self) -> None:
        """Take that what is seen is not what is set: it failed, or was cancelled."""

    def on_scene_changed(self, subject: Subject) -> None:
        """Take that the scene shows the pair, or the world, from now on."""

    def on_show_latest(self) -> None:
        """Take that the whole world is wanted, and not what there was at some time."""

    def entered(self, mode: Mode) -> None:
        """Take that the page is in a mode from now on."""

    def mapped(self) -> None:
        """Take that the world is drawn anew."""

    def checked(self, dataset: Dataset, outcomes: Mapping[PairOfIds, str]) -> None:
        """Take what the truth says of the verdicts of the thresholds; `judged` follows."""

    def decided(self, decisions: Decisions, /) -> None:
        """Take what a person has decided about pairs, after each change of it."""

    def resized(self) -> None:
        """Take that the panels were put away, or back: the canvases become others soon."""

    # How it ends.

    workers: tuple[Worker, ...] = ()
    """Whatever works for the feature in threads of its own."""

    def wait_idle(self, timeout: float) -> bool:
        """Wait until nothing runs; says whether that came true within the timeout [s]."""
        return all(worker.wait_idle(timeout) for worker in self.workers)

    def close(self) -> None:
        """Stop whatever runs."""
        for worker in self.workers:
            worker.close()


F = TypeVar("F", bound=Feature)


# What one feature does for others: the session hands it to those that ask for it.

Frame: TypeAlias = Callable[[viser.ClientHandle | None], None]
"""Brings the camera of a page to all that is shown; None means those of all pages."""
Detect: TypeAlias = Callable[[Progress], DetectionResult]
"""Gives all pairs as the thresholds judge them; those that are missing are registered first."""
Restore: TypeAlias = Callable[[SavedSession], None]
"""Opens what a saved session had open, with all that it had set."""


@runtime_checkable
class Cameras(Protocol):
    """Moves the cameras of the pages."""

    def frame(self, page: viser.ClientHandle | None) -> None:
        """Bring the camera of a page to all that is shown; None means those of all pages."""
        ...

    def look(self, page: viser.ClientHandle, camera: Camera) -> None:
        """Show a page what is shown from where a link has the camera."""
        ...

    def keep_cameras(self) -> None:
        """Leave the cameras where they are when what is shown changes next."""
        ...


@runtime_checkable
class Comparison(Protocol):
    """Registers all pairs with the present parameters."""

    def compare_pairs(self) -> None:
        """Begin to register them; returns at once."""
        ...

    def stop_comparing(self) -> None:
        """Stop registering them."""
        ...


@runtime_checkable
class ModeSwitch(Protocol):
    """Changes what the page is for, and so what the scene shows."""

    def go(self, mode: Mode) -> None:
        """Go to a mode."""
        ...

    def tune(self, query_id: str, database_id: str) -> None:
        """Show a pair in the mode in which it is tuned."""
        ...

    def turn_to(self, subject: Subject) -> None:
        """Show the pair or the world."""
        ...

    @property
    def full_screen(self) -> bool:
        """Whether the panels are put away."""
        ...

    def set_full_screen(self, full_screen: bool) -> None:
        """Put the panels away, or back."""
        ...


def _decided(opened: Opened | None) -> Decisions:
    saved = None if opened is None else opened.saved
    return Decisions() if saved is None else saved.decisions


class Desk:
    """The present state of a session, the requests of its features, and who is told of them.

    Attributes:
        host: Whose GUI and scene the session fills.
        bridge: Hears the HTML of the session.
        canvases: What is known of the pages' canvases.
        numbers: Takes what is typed into number boxes.
        moving: Whether the present parameters are on their way, under a hand.
        memo: Results of the pipeline, shared by all sessions.
        capacity: What a worker must hold while it computes, shared by all sessions.
        permissions: What may be read and written.
        newer: Gives the open dataset anew if it has more submaps by now; else None.
    """

    def __init__(
        self,
        host: Host,
        state: ViewState,
        memo: Memo,
        capacity: Capacity,
        permissions: Permissions = READ_ALL,
        opened: Opened | None = None,
    ) -> None:
        """Begin at a state, without features; it is that of what was opened, if that is given."""
        self.host = host
        self.bridge = Bridge(host)
        self.canvases = Canvases(host, self.bridge)
        self.numbers = Numbers(host, self.bridge)
        self.memo = memo
        self.capacity = capacity
        self.permissions = permissions
        self.moving = False
        self.newer: Callable[[], Opened | None] = lambda: None
        self._state = state
        self._opened = opened
        self._decisions = [_decided(opened)]
        self._features: list[Feature] = []
        self._lock = threading.Lock()

    @property
    def state(self) -> ViewState:
        """The session as it is now."""
        return self._state

    @property
    def features(self) -> tuple[Feature, ...]:
        """All that have joined, in that order."""
        return tuple(self._features)

    def join(self, feature: F) -> F:
        """Tell a feature of everything from now on; returns it."""
        self._features.append(feature)
        return feature

    def begin(self) -> None:
        """Tell all that have joined of what there is."""
        self.notify(lambda feature: feature.decided(self.decisions))
        self.change()

    # Changes of the state.

    def change(
        self,
        *,
        pair: tuple[str | None, str | None] | None = None,
        method: MethodName | None = None,
        params: PipelineParams | None = None,
        options: ViewOptions | None = None,
        match: int | None = None,
        probe: Probe | Literal["as it is"] | None = "as it is",
        only_from: ViewState | None = None,
        moving: bool = False,
    ) -> None:
        """Change the state, and tell all features; without arguments it is only told again.

        Args:
            pair: (query, database) to show; of these, None stays as it is.
            method: To run from now on.
            params: Of that method, as a person gives them: None is automatic.
            options: Of the view.
            match: Number of the association to point at, from 1; 0 for none.
            probe: Place whose values are read; None for none.
            only_from: Nothing is changed if the state is another than this one by now; None
                changes it in any case.
            moving: Whether a hand is still on what changes them; `Feature.rested` follows.

        Raises:
            InputError: If the dataset has no such submap.
        """
        with self._lock:
            state = self._state
            if only_from is not None and only_from is not state:
                return
            if pair is not None:
                state = with_pair(state, query_id=pair[0], database_id=pair[1])
            if method is not None:
                state = with_method(state, method)
            if params is not None:
                state = with_params(state, params)
            if options is not None:
                state = with_options(state, options)
            if match is not None:
                state = with_match(state, match)
            if probe != "as it is":
                state = with_probe(state, probe)
            self.moving = moving
            self._set(state)

    def resolve(self, state: ViewState, used: PipelineParams) -> None:
        """Take the numbers that a fit gives for a state's automatic parameters.

        Nothing is changed if other parameters, another method or another dataset are there by now;
        or another pair, if the numbers are those of the query.
        """
        with self._lock:
            now = self._state
            fits_each = METHODS[now.method].fits_each
            alike = same_pair(now, state) if fits_each else now.dataset is state.dataset
            if alike and (now.method, now.asked) == (state.method, state.asked):
                self._set(with_fitted(now, used))

    def choose(self, query_id: str, database_id: str) -> None:
        """Change to a pair that a page has chosen.

        The page may still show another dataset than the one that was opened just now. Then the pair
        stays as it is, and the features are told so.
        """
        try:
            self.change(pair=(query_id, database_id))
        except InputError:
            self.change()

    def step(self, role: Role, step: int) -> None:
        """Go to the next (1) or the previous (-1) submap as query or database."""
        state = self._state
        query, database = state.query_id, state.database_id
        if role == "query":
            query = neighbour(state.dataset, query, step, skip=database)
        else:
            database = neighbour(state.dataset, database, step, skip=query)
        self.choose(query, database)

    def open(self, opened: Opened) -> None:
        """Go to another dataset."""
        with self._lock:
            self._opened = opened
            self._decisions = [_decided(opened)]
            self._set(opened.begin(self._state.options))
        for feature in self._features:
            feature.opened(opened)
        self.notify(lambda feature: feature.decided(self.decisions))

    def catch_up(self) -> None:
        """Open the submaps that have come since, if the dataset grows; all else stays."""
        newer = self.newer()
        if newer is not None:
            self.open(newer)

    def present(self) -> Opened:
        """Give what another session opens to begin with what this one shows."""
        with self._lock:
            state, opened = self._state, self._opened
            assert opened is not None
            saved = SavedSession(
                query_id=state.query_id,
                database_id=state.database_id if state.is_pair else None,
                options=state.options,
                params=state.asked,
                decisions=self.decisions,
                method=state.method,
            )
            return replace(opened, saved=saved)

    # What a person decided about pairs.

    @property
    def decisions(self) -> Decisions:
        """All decisions of the session as they are now."""
        return self._decisions[-1]

    @property
    def can_take_back(self) -> bool:
        """Whether there is a decision to take back."""
        return len(self._decisions) > 1

    @property
    def shown_pair(self) -> PairOfIds:
        """The pair that is shown, the later submap first, as decisions name it."""
        return self._state.compared_pair

    def decide(self, change: Callable[[Decisions], Decisions], *, step: bool = True) -> None:
        """Change the decisions, and tell all features.

        Args:
            change: Makes the new decisions of the present ones.
            step: Whether it can be taken back by itself; else it belongs to the step before.
        """
        with self._lock:
            after = change(self._decisions[-1])
            if step:
                self._decisions.append(after)
            else:
                self._decisions[-1] = after
        self.notify(lambda feature: feature.decided(after))

    def take_back(self) -> None:
        """Take the last decision back."""
        with self._lock:
            if len(self._decisions) > 1:
                self._decisions.pop()
        self.notify(lambda feature: feature.decided(self.decisions))

    def _set(self, state: ViewState) -> None:
        """Make a state the present one; the lock is held, so that all see the same order."""
        self._state = state
        for feature in self._features:
            feature.follow(state)

    def notify(self, news: Callable[[Feature], None]) -> None:
        """Tell every feature, in the order in which they joined."""
        for feature in self._features:
            news(feature)
