"""The bridge from the viewer's own HTML to Python: a click on a cell of a picture, for instance.

viser shows HTML, but does not report what happens in it. Its pages do run inline handlers, though,
and send what is typed into a text box. So the bridge has a text box that nobody sees: a script
writes a message into it, and viser brings that here like any other input, past the same checks.
The page sends a message again until it is answered, because all inputs of viser's panel share one
throttle, and a slider that moves at that moment can push the message out.
This depends on how viser builds its pages, so nothing else does it, and a browser test watches it.

On the way back, viser runs scripts between two pictures, and draws the scene anew after each; a
picture of a large scene takes a third of a second without a graphics card. Contents of its panels
do not wait, and nothing is drawn for them. So what is sent often, and of which only the newest
counts, goes into hidden HTML, where the script reads it.
"""

import json
from collections.abc import Callable, Mapping
from html import escape
from itertools import count
from typing import Annotated, TypeAlias, TypeVar

import msgspec
import viser

from app.viewer.server.host import Host
from app.viewer.server.internals import messages, send_to, state_of
from app.viewer.web import fill_page_file
from app.viewer.widgets.actions import on_choice_by

Value: TypeAlias = str | float | bool | None
Data: TypeAlias = Mapping[str, Value]
"""What a page says: plain values by name. They come from outside: whoever takes them checks them.
"""
Whole: TypeAlias = Annotated[float, msgspec.Meta(ge=-1, le=1e9, multiple_of=1)]
"""A whole number that a page says, such as a place in a list."""
Record = TypeVar("Record", bound=msgspec.Struct)
Act: TypeAlias = Callable[[viser.ClientHandle, Data], None]

AGAIN_MS = 500
"""After which a message that has no answer is sent again: the throttle may have dropped it, or
the panels are hidden, and the box with them."""
NEWEST = ("heard", "marks", "choices", "lit")
"""What pages receive without waiting for a picture; each replaces the one before."""


class Said(msgspec.Struct, forbid_unknown_fields=True):
    """A message from a page. One that is sent again keeps its number, and differs by its times."""

    number: int
    times: int
    name: str
    data: dict[str, Value]


class PairMsg(msgspec.Struct):
    """A pair of submaps that a page names."""

    query: str
    database: str


class Bridge:
    """Takes what the viewer's own HTML says, and hands it on by name."""

    def __init__(self, host: Host) -> None:
        # unseen container of what pages have and people do not see
        self.folder = host.gui.add_folder("Bridge")
        with self.folder:
            self._box = host.gui.add_text("bridge", "")
            self._newest = {name: host.gui.add_html(_written(name)) for name in NEWEST}
        self._script = host.gui.add_html("")
        self._script.content = self._hidden_script()
        self._numbers = count(1)
        self._acts: dict[str, Act] = {}
        self._taken: dict[int, int] = {}  # the last number of each page
        on_choice_by(self._box, self.take)

    def hear(self, name: str, act: Act) -> None:
        """Register a quick function, which checks its data, for messages of a name from pages."""
        self._acts[name] = act

    def on_message(
        self, name: str, kind: type[Record], act: Callable[[viser.ClientHandle, Record], None]
    ) -> None:
        """Do the same with a record that is checked by its types; others are ignored."""

        def take(page: viser.ClientHandle, data: Data) -> None:
            try:
                record = msgspec.convert(data, kind)
            except msgspec.ValidationError:
                return
            act(page, record)

        self.hear(name, take)

    def call(self, page: viser.ClientHandle, name: str, data: object) -> None:
        """Call in a page, with data of JSON, a function that our script put into ``gpgrad.acts``.

        A page without that name yet does nothing. So a script that needs something requests
        it once it is there. The names in `NEWEST` do not wait for the scene; a page whose panels
        are hidden does not receive them.
        """
        if name in self._newest:
            uuid = state_of(self._newest[name]).uuid
            text = _written(name, next(self._numbers), data)
            send_to(page, messages.GuiUpdateMessage(uuid, {"content": text}))
            return
        send_to(
            page,
            messages.RunJavascriptMessage(
                f"window.gpgrad&&gpgrad.hear({json.dumps(name)},{json.dumps(data)})"
            ),
        )

    def take(self, page: viser.ClientHandle, text: str) -> None:
        """Pass on what a page wrote into the text box; answers the page."""
        said = read_said(text)
        if said is None:
            return
        self.call(page, "heard", said.number)
        if said.number <= self._taken.get(page.client_id, 0):
            return  # sent again before the answer came
        self._taken[page.client_id] = said.number
        if said.name in self._acts:
            self._acts[said.name](page, said.data)

    def _hidden_script(self) -> str:
        box = state_of(self._box).uuid
        script = page_script("bridge.js", BOX=box, AGAIN_MS=AGAIN_MS)
        style = fill_page_file("bridge.css", BOX=box)
        return (
            f'<style>{style}</style><div data-testid="bridge" style="display:none">{script}</div>'
        )


def _written(name: str, *numbered: object) -> str:
    """Write data for the bridge's script; by its number, the same data is another text."""
    return f'<i data-told="{name}">{escape(json.dumps(numbered))}</i>'


def read_said(text: str) -> Said | None:
    """Read a message; None for a text that no script of ours writes."""
    try:
        return msgspec.json.decode(text, type=Said)
    except (msgspec.MsgspecError, UnicodeEncodeError, RecursionError):
        return None


def inline_script(script: str) -> str:
    """Write HTML that runs JavaScript when it is put into a page; values come from `json.dumps`."""
    # A picture that cannot be loaded runs its handler.
    return f'<img alt="" src="data:," style="display:none" onerror="{escape(script)}">'


def page_script(name: str, **values: object) -> str:
    """Write HTML that runs a script of ours, filled with values; see `fill_page_file`."""
    return inline_script(fill_page_file(name, **values))


def send(name: str, /, **data: Value) -> str:
    """Write an inline handler that says something to `Bridge.hear`, escaped for an attribute.

    >>> send("open", query="003")
    'gpgrad.say(&quot;open&quot;,{&quot;query&quot;:&quot;003&quot;})'
    """
    return escape(f"gpgrad.say({json.dumps(name)},{json.dumps(data, separators=(',', ':'))})")
