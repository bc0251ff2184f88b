"""The time line's strip over the canvas, the thread that plays it, and the one that computes it."""

import threading
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import Literal

import msgspec
import viser

from app.viewer.features.desk import Desk, Feature, ModeSwitch
from app.viewer.features.work import message_of
from app.viewer.features.world.model import Past, marks_of
from app.viewer.features.world.tab import WorldTab
from app.viewer.session.jobs import Lane
from app.viewer.session.methods import METHODS
from app.viewer.session.news import DriveNews, SessionState
from app.viewer.session.session_file import Opened
from app.viewer.session.state import ViewState, same_search
from app.viewer.widgets.bridge import page_script
from app.viewer.widgets.commands import Commands
from gpgrad_core.detection import MapDetector, PipelineParams, resolve_parameters
from gpgrad_core.detection.choosing import likely
from gpgrad_core.detection.shortlist import ALL_UP_TO
from gpgrad_core.run import Progress, part
from gpgrad_core.run.threads import num_workers
from gpgrad_core.slam import Drive, Moment, Run
from gpgrad_core.types import Dataset, PairOfIds, Registration

SPEEDS = (1, 2, 4)
STEP_SECONDS, COMING = 1.4, 0.4
"""How long a moment stands at the speed 1 [s], and the share of it before its pairs are judged."""


class TimelineMsg(msgspec.Struct):
    """What a page asks of the time line."""

    act: Literal["play", "at", "speed", "step", "leave", "cancel", "here"]
    value: float = 0.0


class Timeline(Feature):
    """Plays the drive of the open dataset, which it computes at the first request."""

    def __init__(self, desk: Desk, world: WorldTab, modes: ModeSwitch, opened: Opened) -> None:
        self._desk, self._world, self._modes = desk, world, modes
        self._lock = threading.RLock()
        self._state = desk.state
        self._live: Drive | None = None
        self._caught_up: Drive | None = None  # the one whose submaps were opened before
        self._params = opened.params
        self._unlisten = lambda: None
        desk.newer = self._newer
        self._clear()
        desk.host.gui.add_html(page_script("timeline.js"))
        desk.bridge.on_message("timeline", TimelineMsg, self._hear)
        self._computer: Lane[ViewState, None] = Lane(
            desk.jobs,
            self._compute,
            self._computed,
            self._failed,
            on_cancel=self._computed,
            slots=desk.capacity.long,
        )
        self._player: Lane[int, None] = Lane(
            desk.jobs,
            self._play,
            lambda _speed, _nothing, _seconds: self._show(),
            self._failed,
        )
        self._watcher: Lane[bool, None] = Lane(
            desk.jobs,
            lambda follows, _progress: self._show(moving=True) if follows else self._tell(),
            lambda _follows, _nothing, _seconds: None,
            self._failed,
        )
        self._take(opened)

    def _clear(self) -> None:
        self.moments: tuple[Moment, ...] = ()  # as far as they are computed
        self._new = 0  # of them, as many are of the present parameters
        self._fraction: float | None = None
        self._at: int | None = None
        self._playing = False
        self._speed = SPEEDS[0]
        self._used: PipelineParams | None = None
        self._registered: tuple[PipelineParams, dict[PairOfIds, Registration]] | None = None
        self._grown: Dataset | None = None  # the submaps of a drive that goes on
        self._error = ""

    def add_commands(self, commands: Commands) -> None:
        for label, act in (
            ("Play the drive, or rest", self._toggle),
            ("Next moment of the drive", lambda: self._step(1)),
            ("Moment before", lambda: self._step(-1)),
            ("Leave the time line", lambda: self._stand(None)),
        ):
            commands.add("Time line", label, act)

    # What the session tells.

    def on_state(self, before: SessionState, state: SessionState) -> None:
        """Follow the session, computing anew with other parameters; what is opened may drive."""
        with self._lock:
            self._state = state.view
            other = not same_search(before.view, state.view)
            if other:
                self._clear()
                self._unlisten()
                self._live = None
            touched = self._used is not None and self._used != self._state.given
        if other:
            self._player.cancel()
            self._computer.cancel()
            self._world.show_past(None)
            self._tell()
        elif touched and self._live is None and not state.moving:
            self._begin()
        if opened := state.opened_since(before):
            self._take(opened)
        if state.subject != before.subject:
            self._tell()

    def on_drive(self, news: DriveNews) -> None:
        """Show what the map shows by now; leave it for the whole, unless the drive goes on."""
        if news == "drawn":
            self._tell()
        elif self._live is None:
            self._stand(None)

    def close(self) -> None:
        self._unlisten()

    def _take(self, opened: Opened) -> None:
        drive = opened.drive
        if drive is None:
            return
        with self._lock:
            self._used = self._state.given
            if isinstance(drive, Drive) and not drive.finished:
                self._live, self._params = drive, opened.params
                self._unlisten = drive.listen(self._come, self._ended)
            self.moments = drive.moments  # it may have gone on just now
            self._new = len(self.moments)
            self._at = max(self._new - 1, 0)
        self._show()

    # A drive that still goes on.

    def _come(self, _moment: Moment) -> None:
        """Called at the next moment of a drive that goes on; whoever is at its end follows it."""
        with self._lock:
            live = self._live
            if live is None:
                return
            at_end = self._at is None or self._at >= len(self.moments) - 1
            follows = at_end and not self._playing
            self.moments = live.moments
            self._new = len(self.moments)
            if follows:
                self._at = self._new - 1
        self._watcher.submit(follows)  # the drive does not wait for it

    def _ended(self) -> None:
        """Open all submaps of a drive that has ended: now each feature knows them."""
        drive = self._live
        if drive is not None:
            self._desk.open(self._all_of(drive, drive.run))

    def _newer(self) -> Opened | None:
        """All submaps that have come, if the session lacks some of them."""
        drive = self._live
        if drive is None:
            return None
        if len(drive.submaps) > len(self._desk.state.dataset.submaps):
            return self._all_of(drive, drive)
        self._caught_up = drive
        return None

    def _all_of(self, drive: Drive, goes_on: Drive | Run) -> Opened:
        """All submaps that have come; the best loop closure is the pair until a person acts."""
        state, moments = self._state, drive.moments
        saved = self._desk.present().saved if self._caught_up is drive else None
        self._caught_up = drive
        loops = [closure for moment in moments for closure in moment.loops]
        preferred = dict(state.dataset.preferred)
        if loops:
            best = likely(loops)[0]
            preferred |= {"query": best.query_id, "database": best.database_id}
        dataset = replace(state.dataset, submaps=drive.submaps, preferred=preferred)
        used = drive.settings.params
        return Opened(dataset, self._params, state.source, saved, used, goes_on)

    # What the pages ask for; quick.

    def _hear(self, page: viser.ClientHandle, said: TimelineMsg) -> None:
        match said.act:
            case "here":
                self._desk.canvases.show(page, "timeline", self._data())
            case "play":
                self._toggle()
            case "at":
                self._go(int(min(max(said.value, 0), 1e6)))
            case "step":
                self._step(1 if said.value > 0 else -1)
            case "speed":
                self._speed = SPEEDS[(SPEEDS.index(self._speed) + 1) % len(SPEEDS)]
                if self._playing:
                    self._player.submit(self._speed)
                self._tell()
            case "leave":
                self._stand(None)
            case "cancel":
                self._computer.cancel()

    def _toggle(self) -> None:
        plays, at = not self._playing, self._at
        if plays and (at is None or at >= self._count - 1):
            at = -1  # from the start
        self._stand(at, playing=plays)  # at rest no submap is just coming

    def _step(self, step: int) -> None:
        self._go((self._count - 1 if self._at is None else self._at) + step)

    def _go(self, number: int) -> None:
        self._stand(min(max(number, 0), self._count - 1))

    def _stand(self, at: int | None, *, playing: bool = False) -> None:
        """Stand at a moment, or play on from there; None leaves the line for the whole world."""
        with self._lock:
            self._at, self._playing = at, playing
        if not playing:
            self._player.cancel()
        if at is None:
            self._world.show_past(None)
        else:
            self._modes.turn_to("world")
            if self._used is None:
                self._begin()
            if playing:
                self._player.submit(self._speed)
        self._show()

    def _begin(self) -> None:
        with self._lock:
            if any(submap.pose_odometry is None for submap in self._state.dataset.submaps):
                self._error = "The submaps have no odometry, so there is no drive to be shown."
                self._playing, self._at = False, None
                return
            self._used, self._error = self._state.given, ""
            self._fraction, self._new = 0.0, 0
            state = self._state
        self._computer.submit(state)
        self._tell()

    # The thread that computes.

    def _compute(self, state: ViewState, progress: Progress) -> None:
        memo, submaps = self._desk.memo, state.dataset.submaps
        numbers, method = state.given, METHODS[state.method]
        key = method.registered_by(numbers)
        if method.detector is None:
            numbers = resolve_parameters(submaps, numbers, memo, part(progress, 0.0, 0.05))
        with self._lock:
            if self._registered is None or self._registered[0] != key:
                self._registered = key, {}
            registered = self._registered[1]
        with (
            ThreadPoolExecutor(num_workers(), thread_name_prefix="drive") as executor,
            Drive(
                numbers,
                detector=(method.detector or MapDetector)(numbers, memo),
                registered=registered,
                candidates="all" if len(submaps) <= ALL_UP_TO else "automatic",
                executor=executor,
                name=state.dataset.name,
            ) as drive,
        ):
            for k, submap in enumerate(submaps):
                low, high = ((k + more) / len(submaps) for more in (0, 1))
                moment = drive.add(submap, part(progress, 0.05 + 0.95 * low, 0.05 + 0.95 * high))
                self._add(state, moment, high)

    def _add(self, state: ViewState, moment: Moment, fraction: float) -> None:
        number = moment.number
        with self._lock:
            if state.given != self._used or not same_search(state, self._state):
                return
            self.moments = (*self.moments[:number], moment, *self.moments[number + 1 :])
            self._new, self._fraction = number + 1, fraction
            shown = self._at == number and not self._playing
        if shown:
            self._show()
        else:
            self._tell()

    def _computed(self, state: ViewState, *_: object) -> None:
        with self._lock:
            if state.given != self._used:
                return  # another is requested by now
            self._fraction = None
            stopped = self._new < len(self._state.dataset.submaps)
            if stopped:
                self._used = None  # it begins again at the next request
                self.moments = self.moments[: self._new]
        self._show()

    def _failed(self, _job: object, error: Exception) -> None:
        with self._lock:
            self._error, self._fraction, self._playing = message_of(error), None, False
            self._at = None
        self._tell()

    # The thread that plays.

    def _play(self, speed: int, progress: Progress) -> None:
        seconds = STEP_SECONDS / speed
        while True:
            progress(0.0)
            with self._lock:
                number = (-1 if self._at is None else self._at) + 1
                is_known, is_last = number < len(self.moments), number >= self._count
                if not is_known and (is_last or self._fraction is None):
                    self._playing = False
                    return
            if not is_known:
                time.sleep(0.05)
                continue
            start = time.monotonic()
            self._draw(number, decided=False)
            self._wait(start + COMING * seconds, progress)
            with self._lock:
                self._at = number
            self._draw(number, moving=True)
            self._tell()
            self._wait(start + seconds, progress)

    def _wait(self, until: float, progress: Progress) -> None:
        """Wait until a time has come and what was wished for is drawn."""
        while not (self._world.is_drawn(0.02) and time.monotonic() >= until):
            progress(0.0)
            time.sleep(0.01)

    # What is shown.

    @property
    def _count(self) -> int:
        if self._live is not None:
            return max(len(self.moments), 1)
        return len(self._state.dataset.submaps)

    @property
    def _dataset(self) -> Dataset:
        if self._live is None:
            return self._state.dataset
        submaps = self._live.submaps
        if self._grown is None or len(self._grown.submaps) != len(submaps):
            self._grown = replace(self._state.dataset, submaps=submaps)
        return self._grown

    def _draw(self, number: int, *, decided: bool = True, moving: bool = False) -> None:
        with self._lock:
            if not 0 <= number < len(self.moments):
                return
            is_live = self._live is not None
            past = Past(self._dataset, self.moments, number, decided, moving, is_live)
        self._world.show_past(past)

    def _show(self, *, moving: bool = False) -> None:
        """Draw the moment at which the line stands, and say so on all pages."""
        at = self._at
        if at is not None and not self._playing:
            self._draw(at, moving=moving)
        self._tell()

    def _tell(self) -> None:
        self._desk.canvases.show_all("timeline", self._data())

    def _data(self) -> dict[str, object]:
        with self._lock:
            at, moments = self._at, self.moments
            stands = at is not None and 0 <= at < len(moments)
            world, words = self._world.world, self._error
            if not words and world is not None and world.past is not None:
                words = world.past.words
            elif not words and self._fraction is None:
                words = "Play the drive, submap by submap."
            name = moments[at or 0].submap_id if stands else ""
            return {
                "shown": self._desk.now.subject == "world",
                "count": self._count,
                "ready": self._new,
                "at": self._count - 1 if at is None else max(at, 0),
                "name": name,
                "words": words,
                "marks": marks_of(moments),
                "playing": self._playing,
                "speed": self._speed,
                "used": at is not None,
                "busy": self._fraction is not None,
                "live": self._live is not None,
            }
