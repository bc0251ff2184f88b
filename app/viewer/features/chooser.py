"""The chooser: a strip at the head of the canvas that names the pair, and lets people change it.

Each page opens and searches the list by itself; what it chooses is the pair of its session.
"""

from collections.abc import Iterable
from typing import Annotated, Literal

import viser
from msgspec import Meta, Struct

from app.viewer.charts import png_uri
from app.viewer.features.desk import Desk, Feature
from app.viewer.scene.colors import DATABASE, QUERY, css
from app.viewer.scene.thumbnails import portrait
from app.viewer.server.host import pages
from app.viewer.session.jobs import Throttle
from app.viewer.session.news import SessionState
from app.viewer.session.state import Role, ViewState
from app.viewer.widgets.bridge import page_script
from app.viewer.widgets.html import DATABASE_WORDS, QUERY_WORDS
from gpgrad_core.errors import InputError
from gpgrad_core.types import Submap

MOST_LISTED = 60
"""Submaps that are listed at once: words narrow the list."""
MOST_PORTRAITS = 2000
"""Of the newest submaps; each has about four kilobytes."""

Words = Annotated[str, Meta(max_length=200)]


class StripMsg(Struct):
    """What a page asks of the strip; ``name`` is an id, or what was typed to find one."""

    act: Literal["here", "next", "previous", "choose", "swap"]
    role: Role = "query"
    name: Words = ""


class SearchMsg(Struct):
    """What a page has typed to find the submap of a role."""

    role: Role
    text: Words


class Chooser(Feature):
    """Shows the strip while a pair is on the canvas and the panels are there."""

    def __init__(self, desk: Desk) -> None:
        self._desk = desk
        self._sent: dict[str, object] = {}
        self._portraits: dict[str, str] = {}  # by fingerprint, as the pages keep them
        script = page_script(
            "chooser.js",
            SIDES=[
                ["query", "Query", css(QUERY), QUERY_WORDS],
                ["database", "Database", css(DATABASE), DATABASE_WORDS],
            ],
        )
        desk.host.gui.add_html(script)
        desk.bridge.on_message("pair", StripMsg, self._hear)
        desk.bridge.on_message("pair-search", SearchMsg, self._search)
        self._painter: Throttle[Submap] = Throttle(desk.jobs, self._paint, 0.0)

    # What the session tells.

    def on_state(self, before: SessionState, state: SessionState) -> None:
        """Name the pair; leave the canvas to the map, or the full screen to the picture."""
        del before, state  # the desk has it
        self._tell()

    # What the pages ask for; quick.

    def _hear(self, page: viser.ClientHandle, said: StripMsg) -> None:
        state = self._desk.state
        match said.act:
            case "here":
                self._show(page, self._data())
                self._send_portraits(page, (state.query, state.database))
            case "next" | "previous":
                self._desk.step(said.role, 1 if said.act == "next" else -1)
            case "swap":
                self._desk.choose(state.database_id, state.query_id)
            case "choose":
                found = find_ids(state, said.name)
                name = said.name if said.name in found else next(iter(found), None)
                if name is not None:  # if it has the other role, the two change places
                    self._desk.choose(**{f"{said.role}_id": name})

    def _search(self, page: viser.ClientHandle, said: SearchMsg) -> None:
        """List what a text finds, with the submap that has the role marked."""
        if not said.text:  # the list was opened just now
            self._desk.catch_up()
        state = self._desk.state
        found = find_ids(state, said.text)
        now = state.query_id if said.role == "query" else state.database_id
        at = found.index(now) if now in found else 0
        first = max(min(at - MOST_LISTED // 2, len(found) - MOST_LISTED), 0)
        shown = found[first : first + MOST_LISTED]
        submaps = [state.dataset.submap(name) for name in shown]
        answer = {
            "role": said.role,
            "text": said.text,
            "found": shown,
            "pictures": [submap.fingerprint for submap in submaps],
            "at": at - first,
            "more": len(found) - len(shown),
        }
        self._desk.canvases.show(page, "choices", answer)
        self._send_portraits(page, submaps)

    # What is shown.

    def _data(self) -> dict[str, object]:
        now, state = self._desk.now, self._desk.state
        seen = now.subject == "pair" and state.is_pair and not now.full_screen
        return {
            "shown": seen,
            "query": state.query_id,
            "database": state.database_id,
            "count": len(state.dataset.submaps),
            "pictures": {
                "query": state.query.fingerprint,
                "database": state.database.fingerprint,
            },
        }

    def _tell(self) -> None:
        data = self._data()
        if data == self._sent:
            return
        self._sent = data
        state = self._desk.state
        for page in pages(self._desk.host).values():
            self._show(page, data)
            self._send_portraits(page, (state.query, state.database))

    def _show(self, page: viser.ClientHandle, data: dict[str, object]) -> None:
        self._desk.canvases.show(page, "pair", data)

    def _send_portraits(self, page: viser.ClientHandle, submaps: Iterable[Submap]) -> None:
        """Send a page those that are there, and request the others."""
        made: dict[str, str] = {}
        for submap in submaps:
            known = self._portraits.get(submap.fingerprint)
            if known is None:
                self._painter.request(submap)
            else:
                made[submap.fingerprint] = known
        if made:
            self._desk.canvases.show(page, "portraits", made)

    def _paint(self, submap: Submap) -> None:
        """Make the portrait of a submap, and send it to all pages: any may list it."""
        name = submap.fingerprint
        if name not in self._portraits:
            try:
                picture = png_uri(portrait(submap))
            except InputError:
                picture = ""  # its ground has no grid, which the status line says
            if len(self._portraits) >= MOST_PORTRAITS:
                self._portraits.pop(next(iter(self._portraits)))
            self._portraits[name] = picture
        self._desk.canvases.show_all("portraits", {name: self._portraits[name]})


def find_ids(state: ViewState, text: str) -> list[str]:
    """List the ids that have a text in them, those that begin with it first."""
    sought = text.strip().casefold()
    found = [submap.id for submap in state.dataset.submaps if sought in submap.id.casefold()]
    return sorted(found, key=lambda name: not name.casefold().startswith(sought))
