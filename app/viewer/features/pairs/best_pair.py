"""The best pair: the likeliest pairs are scored, so that a dataset opens on a loop closure."""

import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass
from html import escape
from itertools import count
from typing import TypeAlias

import msgspec
import viser

from app.viewer.features.desk import Desk, Feature, ModeSwitch
from app.viewer.features.work import message_of
from app.viewer.server.host import Host
from app.viewer.session.jobs import Lane
from app.viewer.session.methods import METHODS, register_pair
from app.viewer.session.news import AllPairs, PairNews, PairShown, SessionState
from app.viewer.session.session_file import Opened
from app.viewer.session.state import NEEDS_TWO, ViewState, same_search, was_fitted
from app.viewer.widgets.actions import on_press
from app.viewer.widgets.bridge import PairMsg, Whole, page_script, send
from app.viewer.widgets.commands import Commands
from app.viewer.widgets.html import button
from gpgrad_core.detection import infer_features
from gpgrad_core.detection.choosing import likely, overlapping_pairs, voted_pairs
from gpgrad_core.run import Progress, part
from gpgrad_core.run.threads import at_most_workers
from gpgrad_core.types import Features, LoopClosure, PairOfIds, Submap

# Over the lower middle of the picture: the panels cover its sides, the caption is above, and the
# colours' legend below. No row of a panel moves.
PLACE = (
    "position:fixed;bottom:108px;left:50%;transform:translateX(-50%);z-index:4;box-sizing:border-box;"
    "width:max-content;max-width:min(27rem,94vw);padding:.5em .8em;border-radius:.5em;"
    "font-size:13px;line-height:1.45;background:var(--gg-surface);"
    "color:var(--gg-text);border:1px solid var(--gg-line);"
    "box-shadow:0 2px 8px rgba(0,0,0,.25)"
)
APART = "margin:.4em .5em 0 0"


class BestPairNote:
    """A note that lies over the picture; it is there while there is something to say."""

    def __init__(self, host: Host) -> None:
        self._handle = host.gui.add_html("")

    def say(
        self, text: str, choices: tuple[tuple[str, str, str], ...] = (), *, watch: int | None = None
    ) -> None:
        """Show a text above buttons (label, query, database); an act on a page sends ``watch``."""
        buttons = [
            button(label, send("show-pair", query=query, database=database), APART)
            for label, query, database in choices
        ]
        script = ""
        if watch is not None:
            script = page_script("best_pair.js", NUMBER=watch)
        else:
            buttons.append(button("Close", send("close-note"), APART))
        self._handle.content = (
            f'<div data-testid="best-pair" role="status" style="{PLACE}">{escape(text)}'
            f"<div>{''.join(buttons)}</div></div>{script}"
        )

    def clear(self) -> None:
        self._handle.content = ""


MOST_PAIRS = 8
"""So many of the likeliest pairs are scored at most."""
ENOUGH = 1.2
"""Once there is a loop closure, and so much time has passed, the best one is shown [s]."""
EXTRACTING = 0.8
"""Share of the progress that the keypoints of all submaps take, where there are no poses."""


@dataclass(frozen=True, eq=False)
class _Search:
    """What is searched; its pair is shown only if the session is still in that state."""

    number: int  # for the pages
    state: ViewState  # of the session when it began
    began: float  # [s]
    asked: bool  # by somebody; else it began because the pair is no loop closure


_Best: TypeAlias = tuple[LoopClosure | None, int]
"""The loop closure with the highest score, if there was one, and the number of scored pairs."""


class TouchedMsg(msgspec.Struct):
    """Somebody has acted on a page that was to tell so, with the number of a search."""

    number: Whole


class BestPair(Feature):
    """Scores the likeliest pairs of a dataset that opened on none, until anybody acts."""

    def __init__(self, desk: Desk, opened: Opened, commands: Commands, modes: ModeSwitch) -> None:
        self._modes = modes
        self._desk = desk
        self._lock = threading.Lock()
        self._numbers = count(1)
        self._due = opened.saved is None  # once the first picture is there
        self._shown: PairShown | None = None
        self._running: _Search | None = None
        self._noted: PairOfIds | None = None  # the pair that the note is about
        self._button: viser.GuiButtonHandle | None = None
        self.note = BestPairNote(desk.host)
        self._runner: Lane[_Search, _Best] = Lane(
            desk.jobs,
            self._search,
            self._on_best,
            self._on_error,
            slots=desk.capacity.long,
        )
        desk.bridge.on_message("touched", TouchedMsg, self._on_touched)
        desk.bridge.on_message(
            "show-pair", PairMsg, lambda _, msg: modes.tune(msg.query, msg.database)
        )
        desk.bridge.hear("close-note", lambda page, data: self.note.clear())  # noqa: ARG005
        commands.add("Pair", "Show the best loop closure", self.show_best)

    def add_button(self) -> None:
        self._button = self._desk.host.gui.add_button(
            "Show best",
            disabled=True,
            hint="Shows the loop closure with the highest score of all pairs that were run.",
        )
        on_press(self._button, self.show_best)

    # What happens.

    def on_state(self, before: SessionState, state: SessionState) -> None:
        """Stop if anybody has changed anything; another dataset is another search."""
        was, now = before.view, state.view
        if now is not was and not was_fitted(was, now):
            self._stop()
            pair, other = (now.query_id, now.database_id), now.dataset is not was.dataset
            # A saved session is left as it was saved.
            self._due = other and (state.opened is None or state.opened.saved is None)
            if other or (self._noted is not None and pair != self._noted):
                self._noted = None
                self.note.clear()
            if not same_search(was, now):
                self._offer_best()
        if state.subject != before.subject == "pair":  # the note does not concern the world
            self._stop()
            self.note.clear()
        elif state.subject != before.subject and self._shown is not None:
            self.on_pair_result(self._shown)

    def on_pair_result(self, news: PairNews) -> None:
        """Begin once the first picture is there, if it shows no loop closure."""
        if not isinstance(news, PairShown):
            return
        self._shown = news
        if not self._due or news.state is not self._desk.state or self._desk.now.subject != "pair":
            return
        self._due = False
        if not news.result.closure.accepted and len(news.state.dataset.submaps) > 2:
            self._begin(news.state, asked=False)

    def on_pairs(self, before: AllPairs, pairs: AllPairs) -> None:
        """Make way for the comparison of all pairs, and know its best."""
        if pairs.fraction is not None and pairs.fraction != before.fraction:
            self._due = False
            self._stop()
        if pairs.verdicts is not before.verdicts:
            self._offer_best()

    def _offer_best(self) -> None:
        if self._button is not None:
            self._button.disabled = self._best_judged() is None

    # Requests.

    def show_best(self) -> None:
        best = self._best_judged()
        if best is not None:
            self._modes.tune(*best.pair)
        elif not self._desk.state.is_pair:
            self.note.say(NEEDS_TWO)
        elif self._running is None:
            self._begin(self._desk.state, asked=True)

    def _best_judged(self) -> LoopClosure | None:
        closures = likely(self._desk.verdicts.found.closures)
        return next((closure for closure in closures if closure.accepted), None)

    def _on_touched(self, _page: viser.ClientHandle, msg: TouchedMsg) -> None:
        if self._running is not None and msg.number == self._running.number:
            self._stop()

    def _begin(self, state: ViewState, *, asked: bool) -> None:
        job = _Search(next(self._numbers), state, time.monotonic(), asked)
        self._running, self._noted = job, (state.query_id, state.database_id)
        self._tell(job, "The likeliest pairs are being chosen …")
        self._runner.submit(job)

    def _stop(self) -> None:
        job = self._running
        if job is not None and self._end(job):
            self._runner.cancel()
            self.note.clear()
            self._desk.host.flush()

    def _end(self, job: _Search) -> bool:
        """Mark a search as ended; returns whether it had not ended before."""
        with self._lock:
            ends = self._running is job
            if ends:
                self._running = None
            return ends

    def _tell(self, job: _Search, text: str) -> None:
        if job is self._running:
            why = "" if job.asked else "This pair is no loop closure. "
            self.note.say(why + text, watch=job.number)
            self._desk.host.flush()

    # What the worker does.

    def _search(self, job: _Search, progress: Progress) -> _Best:
        best: LoopClosure | None = None
        num_scored = 0
        state, memo = job.state, self._desk.memo
        with at_most_workers(1):
            for pair in self._likely(job, progress):
                query, database = map(state.dataset.submap, pair)
                closure = register_pair(
                    query, database, state.given, memo, progress, method=state.method
                ).closure
                num_scored += 1
                score = closure.registration.score
                if closure.accepted and (best is None or score > best.registration.score):
                    best = closure
                if best is not None and time.monotonic() - job.began > ENOUGH:
                    break
        return best, num_scored

    def _likely(self, job: _Search, progress: Progress) -> Iterator[PairOfIds]:
        state = job.state
        opened = set[str]() if job.asked else {state.query_id, state.database_id}
        pairs = overlapping_pairs(state.dataset, MOST_PAIRS + 1)
        if not pairs:
            told = part(progress, 0.0, EXTRACTING)

            def extract(submap: Submap) -> Features:
                self._tell(job, f"No poses are known: the keypoints of {submap.id} are compared …")
                memo = self._desk.memo
                params = METHODS[state.method].of_submap(submap, state.given, memo, told)
                return infer_features(submap, params, memo, told)

            pairs = voted_pairs(state.dataset, MOST_PAIRS + 1, extract, told)
        others = [pair for pair in pairs if set(pair) != opened][:MOST_PAIRS]
        for number, pair in enumerate(others, start=1):
            progress(EXTRACTING)
            self._tell(job, f"The likeliest pairs are being scored: {number} of {len(others)} …")
            yield pair

    def _on_best(self, job: _Search, outcome: _Best, _seconds: float) -> None:
        if not self._end(job):
            return  # somebody has acted
        best, num_scored = outcome
        opened = job.state.query_id, job.state.database_id
        if best is None:
            self.note.say(_nothing(num_scored))
        else:
            self._noted = best.pair
            self._desk.change(pair=best.pair, only_from=job.state)
            now = self._desk.state
            if (now.query_id, now.database_id) == best.pair:
                back = f"{opened[0]} → {opened[1]}"
                none = "" if job.asked else f" {back} is none."
                self.note.say(
                    f"Switched to {best.query_id} → {best.database_id}, the best loop closure so "
                    f"far.{none}",
                    () if opened == best.pair else ((f"Back to {back}", *opened),),
                )
            else:
                self.note.clear()
        self._desk.host.flush()

    def _on_error(self, job: _Search, error: Exception) -> None:
        if self._end(job):
            self.note.say(f"The likeliest pairs could not be scored: {message_of(error)}")
            self._desk.host.flush()


def _nothing(num_scored: int) -> str:
    if not num_scored:
        return "No other pair overlaps by the poses. Run all pairs to compare the rest."
    pairs = "pair is" if num_scored == 1 else f"{num_scored} pairs are"
    return f"No loop closure so far: the likeliest {pairs} none. Run all pairs to compare the rest."
