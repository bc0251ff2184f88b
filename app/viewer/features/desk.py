"""The features of the viewer and their desk: what a feature requests, and what reaches it.

A feature is a tab or a tool. It knows its session by one object, the desk. It reads the present
state there and requests changes there; the desk notifies all features of each. What one
feature does for another is a call: the session hands it over as one of the narrow protocols
below. So no feature needs to know another.
"""

import logging
import threading
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Protocol, TypeAlias, TypedDict, TypeVar, runtime_checkable

import viser
from typing_extensions import Unpack

from app.viewer.server.host import Host
from app.viewer.server.limits import READ_ALL, Permissions
from app.viewer.session.decisions import Decisions, decide
from app.viewer.session.jobs import Capacity, Jobs
from app.viewer.session.methods import METHODS, MethodName
from app.viewer.session.news import (
    AllPairs,
    DriveNews,
    Mode,
    PairNews,
    SessionState,
    Subject,
    Verdicts,
)
from app.viewer.session.session_file import Keyframe, Opened, SavedSession
from app.viewer.session.state import (
    Camera,
    Probe,
    Role,
    Setting,
    ViewOptions,
    ViewState,
    neighbour,
    same_pair,
    same_search,
    with_fitted,
    with_method,
    with_pair,
    with_params,
)
from app.viewer.widgets.bridge import Bridge
from app.viewer.widgets.canvas import Canvases
from app.viewer.widgets.numbers import Numbers
from gpgrad_core.detection import DetectionResult, PipelineParams
from gpgrad_core.errors import InputError
from gpgrad_core.run import Progress
from gpgrad_core.run.memo import Memo
from gpgrad_core.types import LoopClosure

_log = logging.getLogger(__name__)


class Feature:
    """Everything that may reach a feature; each overrides what concerns it.

    All of it must be quick: what takes longer than a few milliseconds belongs to a `Lane` of
    its own in the session's jobs. Every feature receives everything in the same order.
    """

    def on_state(self, before: SessionState, state: SessionState) -> None:
        """Called with each new state; the same as before is to be shown anew."""

    def on_pair_result(self, news: PairNews) -> None:
        """Called when what is shown of the pair, or of the one submap, has changed."""

    def on_pairs(self, before: AllPairs, pairs: AllPairs) -> None:
        """Called when all pairs are compared, and when they are judged anew."""

    def on_drive(self, news: DriveNews) -> None:
        """Called when the world was drawn, and when the latest is to be shown."""

    def close(self) -> None:
        """Called at the end, when no job runs any more."""


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
        """Frame all that is shown with the camera of a page; None means those of all pages."""

    def look(self, page: viser.ClientHandle, camera: Camera) -> None:
        """Show a page what is shown from where a link has the camera."""

    def keep_cameras(self) -> None:
        """Do not move the cameras when what is shown changes next."""


@runtime_checkable
class ModeSwitch(Protocol):
    """Changes what the page is for, and so what the scene shows."""

    def go(self, mode: Mode) -> None: ...

    def tune(
        self, query_id: str, database_id: str, *, back_to: Mapping[int, Camera] | None = None
    ) -> None:
        """Show a pair in the mode in which it is tuned; pages come back to views of the map."""

    def turn_to(self, subject: Subject) -> None: ...

    def set_full_screen(self, full_screen: bool) -> None: ...


class Drawn(TypedDict, total=False):
    """What of a `ViewState` says how to draw it."""

    options: ViewOptions
    match: int
    probe: Probe | None
    reference: Setting | None


def _decided(opened: Opened | None) -> tuple[Decisions, ...]:
    saved = None if opened is None else opened.saved
    return (Decisions() if saved is None else saved.decisions,)


def _keyframes(opened: Opened | None) -> tuple[Keyframe, ...]:
    return () if opened is None or opened.saved is None else opened.saved.keyframes


class Desk:
    """The present state of a session, the requests of its features, and who is notified of them.

    A change sets the state, and puts the news into a queue. If no other thread delivers, the
    caller delivers all of it, without a lock; others wait until theirs are delivered. So all
    features see all news in one order, and a change has reached all of them when it returns.
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
        """Begin at a state, without features; it is that of ``opened``, unless that is None."""
        self.host = host  # whose GUI and scene the session fills
        self.bridge = Bridge(host)  # hears the HTML of the session
        self.canvases = Canvases(host, self.bridge)  # properties of the pages' canvases
        self.numbers = Numbers(host, self.bridge)  # receives what is typed into number boxes
        self.jobs = Jobs()  # does the work of all features
        self.memo = memo  # results of the pipeline, shared by all sessions
        self.capacity = capacity  # what a job must hold while it computes, shared by all sessions
        self.permissions = permissions  # what may be read and written
        # returns the open dataset anew if it has more submaps by now; else None
        self.newer: Callable[[], Opened | None] = lambda: None
        # the session as it is now; only the desk sets it
        self.now = SessionState(state, opened, _decided(opened), keyframes=_keyframes(opened))
        self._pairs = AllPairs()
        self._decided = DetectionResult((), {}), Decisions(), tuple[LoopClosure, ...]()
        # all that have joined, in the order in which they are notified
        self.features: list[Feature] = []
        self._changed = self.jobs.changed
        self._news: deque[Callable[[Feature], None]] = deque()
        self._num_delivered = 0
        self._teller: int | None = None  # the thread that tells the features just now

    @property
    def state(self) -> ViewState:
        return self.now.view

    @property
    def verdicts(self) -> Verdicts:
        """Those on all pairs of the present dataset by the present method; empty without any."""
        state, verdicts = self.state, self._pairs.verdicts
        if verdicts is not None and same_search(verdicts.state, state):
            return verdicts
        return Verdicts(state, state.params)

    @property
    def closures(self) -> tuple[LoopClosure, ...]:
        """The same pairs as a person decided about them, and those that were set by hand."""
        found, decisions, decided = self.verdicts.found, self.now.decisions, self._decided
        if decided[0] is not found or decided[1] is not decisions:
            decided = self._decided = found, decisions, decide(found.closures, decisions)
        return decided[2]

    def join(self, feature: F) -> F:
        self.features.append(feature)
        return feature

    # Who is notified.

    def update(
        self, change: Callable[[SessionState], SessionState | None], *, deliver: bool = True
    ) -> None:
        """Change the state, unless that gives None; tell all now, or at the next `deliver`."""
        with self._changed:
            before = self.now
            after = change(before)
            if after is None:
                return
            self.now = after
            if not same_search(before.view, after.view):
                self._pairs = self._pairs._replace(verdicts=None, so_far=None)
            self._news.append(lambda feature: feature.on_state(before, after))
        if deliver:
            self.deliver()

    def update_pairs(self, change: Callable[[AllPairs], AllPairs]) -> None:
        with self._changed:
            before, after = self._pairs, change(self._pairs)
            self._pairs = after
            self._news.append(lambda feature: feature.on_pairs(before, after))
        self.deliver()

    def notify(self, news: Callable[[Feature], None]) -> None:
        """Notify every feature, in the order in which they joined."""
        with self._changed:
            self._news.append(news)
        self.deliver()

    def tell_again(self) -> None:
        self.update(lambda state: state)

    def deliver(self) -> None:
        """Notify the features of all news so far, or wait until another thread has done so."""
        me = threading.get_ident()
        with self._changed:
            if self._teller == me:
                return
            end = self._num_delivered + len(self._news) + (self._teller is not None)
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._teller is None or self._num_delivered >= end)
                if self._teller is not None or not self._news:
                    return
                self._teller, news = me, self._news.popleft()
            self._tell(news)
            with self._changed:
                self._teller, self._num_delivered = None, self._num_delivered + 1
                self._changed.notify_all()

    def _tell(self, news: Callable[[Feature], None]) -> None:
        for feature in self.features:
            try:
                news(feature)
            except Exception:  # the others are notified nevertheless
                _log.exception("%s could not take the news", type(feature).__name__)

    def wait_idle(self, timeout: float) -> bool:
        """Wait until nothing is left to deliver or do; returns False if that takes longer [s]."""

        def is_idle() -> bool:
            return not (self.jobs.is_busy or self._news or self._teller)

        with self._changed:
            return self._changed.wait_for(is_idle, timeout)

    def close(self) -> None:
        self.jobs.close()
        for feature in self.features:
            feature.close()

    # Changes of the state.

    def change(
        self,
        *,
        pair: tuple[str | None, str | None] | None = None,
        method: MethodName | None = None,
        params: PipelineParams | None = None,
        only_from: ViewState | None = None,
        moving: bool = False,
        **drawn: Unpack[Drawn],
    ) -> None:
        """Change what pictures show.

        Of the pair (query, database), None stays as it is; in the parameters, it is automatic. If
        the state is another than ``only_from`` by now, nothing is changed. While a hand is still
        on what changes them, they are moving, and `release` follows. An InputError says that the
        dataset has no such submap.
        """

        def changed(now: SessionState) -> SessionState | None:
            view = now.view
            if only_from is not None and only_from is not view:
                return None
            if pair is not None:
                view = with_pair(view, query_id=pair[0], database_id=pair[1])
            if method is not None:
                view = with_method(view, method)
            if params is not None:
                view = with_params(view, params)
            return replace(now, view=replace(view, **drawn), moving=moving)

        self.update(changed)

    def release(self, params: PipelineParams) -> None:
        """Set the parameters at which a slider was released; a busy page reports it late."""
        self.update(lambda now: replace(now, moving=False, released=params))

    def resolve(self, state: ViewState, used: PipelineParams) -> None:
        """Set the numbers of a fit, unless what they were fitted to is another by now."""

        def resolved(now: SessionState) -> SessionState | None:
            view = now.view
            fits_each = METHODS[view.method].fits_each
            alike = same_pair(view, state) if fits_each else view.dataset is state.dataset
            if not alike or (view.method, view.asked) != (state.method, state.asked):
                return None
            return replace(now, view=with_fitted(view, used))

        self.update(resolved)

    def choose(self, query_id: str | None = None, database_id: str | None = None) -> None:
        """Choose what a page has chosen; if it is of another dataset, nothing is changed."""
        try:
            self.change(pair=(query_id, database_id))
        except InputError:
            self.tell_again()

    def leave_reference(self) -> None:
        if self.state.reference is not None:
            self.change(reference=None)

    def step(self, role: Role, step: int) -> None:
        state = self.state
        query, database = state.query_id, state.database_id
        if role == "query":
            query = neighbour(state.dataset, query, step, skip=database)
        else:
            database = neighbour(state.dataset, database, step, skip=query)
        self.choose(query, database)

    def open(self, opened: Opened) -> None:
        self.update(
            lambda now: replace(
                now,
                view=opened.begin(now.view.options),
                opened=opened,
                decided=_decided(opened),
                keyframes=_keyframes(opened),
            )
        )

    def catch_up(self) -> None:
        """Open the submaps that have come since, if the dataset grows; all else stays."""
        newer = self.newer()
        if newer is not None:
            self.open(newer)

    def present(self) -> Opened:
        """What another session opens to begin with what this one shows."""
        now = self.now
        assert now.opened is not None
        saved = SavedSession.of(now.view, decisions=now.decisions, keyframes=now.keyframes)
        return replace(now.opened, saved=saved)

    # What a person decided about pairs.

    def decide(self, change: Callable[[Decisions], Decisions], *, step: bool = True) -> None:
        """Change the decisions, in a step that can be taken back by itself, or in that before."""

        def decided(now: SessionState) -> SessionState:
            kept = now.decided if step else now.decided[:-1]
            return replace(now, decided=(*kept, change(now.decisions)))

        self.update(decided)

    def take_back(self) -> None:
        """Undo the last decision; the first state of them stays."""
        self.update(lambda now: replace(now, decided=now.decided[:-1] or now.decided))
