"""Links: the address of a page says what is shown, and opening it shows the same."""

from functools import partial
from pathlib import Path
from typing import Literal

import viser
from msgspec import Struct

from app.viewer.features.desk import Cameras, Desk, Feature, ModeSwitch, Restore
from app.viewer.scene.cameras import view_of
from app.viewer.server.host import Host, PerPage, pages
from app.viewer.session.jobs import Throttle
from app.viewer.session.news import Mode, SessionState
from app.viewer.session.session_file import LONGEST, SavedSession, address_of, read_address
from app.viewer.session.state import ViewState
from app.viewer.web import fill_page_file
from app.viewer.widgets.bridge import inline_script, page_script
from app.viewer.widgets.commands import Commands
from app.viewer.widgets.html import paragraph
from gpgrad_core.errors import InputError
from gpgrad_core.simulation.demo import demo_path

PAUSE = 0.4
"""Between two changes of an address [s], for browsers refuse very many."""
ACTED = 10.0
"""What changes so long after a person has acted on a page is thought to come of that [s]."""


def add_script(host: Host) -> None:
    """Add the script of the addresses to the current container, which must not be a tab."""
    script = page_script("links.js", MOST_LETTERS=LONGEST + 1, ACTED_MS=1000 * ACTED)
    host.gui.add_html(script)


def link_html(*, has_link: bool) -> str:
    """Write the box with a page's own link, as each has a camera, and the button that copies it."""
    if not has_link:
        return paragraph(
            "This dataset has no link, because it was uploaded or has no path on the server. Save "
            "the session instead.",
            "opacity:.8",
        )
    intro = paragraph(
        "The address of this page follows what is shown: dataset, pair, parameters, layers and "
        "camera. Whoever opens it on this viewer sees the same."
    )
    fill = inline_script(
        "window.gpgradLink&&(this.parentNode.querySelector('input').value=gpgradLink.link())"
    )
    return intro + fill_page_file("link.html", FILL=fill)


def tell(page: viser.ClientHandle, title: str, body: str) -> None:
    """Show a note about a link on the page that it concerns."""
    page.add_notification(title, body, auto_close_seconds=12.0, with_close_button=True)


class Address(Struct):
    """What a page has behind ``#``, and the mode if it is an entry of the browser's history."""

    text: str
    mode: Mode | Literal[""] = ""
    again: bool = False  # whether the server was gone meanwhile


class Copied(Struct):
    """Whether a page could copy its link."""

    copied: bool


class Links(Feature):
    """Writes what is shown into the addresses of the pages, and reads that of a page that comes."""

    def __init__(
        self,
        desk: Desk,
        commands: Commands,
        modes: ModeSwitch,
        cameras: Cameras,
        restore: Restore,
    ) -> None:
        self._desk = desk
        self._modes = modes
        self._cameras = cameras
        self._restore = restore
        self._body = desk.host.gui.add_html(link_html(has_link=True))
        # Of each page the address that it was sent; None if it may have another one now.
        self._arrived = PerPage[tuple[str, str] | None]()
        self._throttle: Throttle[viser.ClientHandle] = Throttle(desk.jobs, self._publish, PAUSE)
        desk.bridge.on_message("arrived", Address, self._arrive)
        desk.bridge.on_message("asked", Address, self._take)
        desk.bridge.on_message("link copied", Copied, _say_copied)
        copy = partial(desk.bridge.call, name="copy", data={})
        commands.add_for_page("Session", "Copy link", copy, key="L", modifier="shift")

    def on_state(self, before: SessionState, state: SessionState) -> None:
        """Write what is shown now; of what a link asks for, the rest once its dataset is there."""
        content = link_html(has_link=bool(self._address(state.view)))
        if self._body.content != content:
            self._body.content = content
        for page in pages(self._desk.host).values():
            if page in self._arrived:
                self._throttle.request(page)
        opened = state.opened_since(before)
        if opened is not None and opened.saved is not None and opened.saved.subject == "world":
            self._modes.go("Explore")

    def _address(self, state: ViewState, page: viser.ClientHandle | None = None) -> str:
        """Write the address for a page; without one, as no camera was moved."""
        uploads = self._desk.permissions.uploads
        if uploads is not None and Path(state.source).is_relative_to(uploads):
            return ""
        camera = None
        if page is not None and self._desk.now.subject == "pair":
            camera = view_of(page) if self._desk.canvases.is_by_hand(page) else None
        return address_of(state, self._desk.now.subject, camera)

    def _publish(self, page: viser.ClientHandle) -> None:
        if page not in pages(self._desk.host).values():
            return
        state = self._desk.state
        text = self._address(state, page)
        # What is another entry of the browser's history; the mode has no spaces.
        place = f"{self._desk.now.mode} {state.query_id} {state.database_id} {state.source}"
        if self._arrived.get(page) != (text, place):
            self._arrived[page] = text, place
            self._desk.bridge.call(page, "address", {"text": text, "place": place})

    # A page that comes.

    def _arrive(self, page: viser.ClientHandle, address: Address) -> None:
        if page in self._arrived:
            return
        self._arrived[page] = None
        if address.text:
            self._open(page, address.text, again=address.again)

        @page.camera.on_update
        async def _(_camera: viser.CameraHandle) -> None:
            self._throttle.request(page)

        self._throttle.request(page)

    def _take(self, page: viser.ClientHandle, address: Address) -> None:
        """Show what a page asks for that is there already: by a pasted link, back or forward."""
        if page in self._arrived:
            self._arrived[page] = None  # so that what is shown is written over it
            self._open(page, address.text, mode=address.mode)
            self._throttle.request(page)

    def _open(
        self,
        page: viser.ClientHandle,
        text: str,
        *,
        again: bool = False,
        mode: Mode | Literal[""] = "",
    ) -> None:
        """Show what an address asks for, unless others would lose what they look at.

        Back and forward are an act like others, which all see; they have a mode. Where the server
        was gone meanwhile, the dataset that it has now stays open.
        """
        state = self._desk.state
        try:
            link = read_address(text, state.options)
        except InputError as error:
            tell(page, "The link cannot be opened", str(error))
            return
        if len(pages(self._desk.host)) > 1 and not mode:
            if not _asks_for(link, state):
                tell(
                    page,
                    "You have joined a session",
                    "Others have this viewer open, and all pages show the same. What your link "
                    "asks for is not shown. To see it, press Work alone and open it again.",
                )
            elif link.subject == self._desk.now.subject == "pair" and link.camera is not None:
                self._cameras.look(page, link.camera)
            return
        if _has_open(link, state):
            self._change(page, link, mode)
            return
        if again:
            tell(
                page,
                "The server shows another dataset now",
                f"Before, this page showed {link.dataset or 'the demo'}. Open it in the tab Data.",
            )
            return
        # By the same way as a saved session: what may not be opened there may not be here.
        where = "the demo" if link.dataset is None else str(link.dataset)
        tell(
            page,
            "Opening the dataset of the link",
            f"Loading {where}. If it does not appear, the tab Data says why.",
        )
        self._restore(link)

    def _change(
        self, page: viser.ClientHandle, link: SavedSession, mode: Mode | Literal[""]
    ) -> None:
        try:
            pair = link.query_id, link.database_id
            self._desk.change(
                pair=pair,
                method=link.method,
                params=link.params,
                options=link.options,
                reference=link.reference,
            )
        except InputError as error:
            tell(page, "The link cannot be opened", str(error))
            return
        if mode == "Demo":
            self._modes.turn_to(link.subject)
        if link.subject == "world":
            self._modes.go(mode or "Explore")
            return
        if mode or self._desk.now.subject == "world":
            self._modes.go(mode or "Tune")
        if link.camera is not None:
            self._cameras.look(page, link.camera)
        elif self._desk.canvases.is_by_hand(page):
            self._cameras.frame(page)


def _has_open(link: SavedSession, state: ViewState) -> bool:
    wanted = link.dataset or demo_path()
    if not state.source:
        return False
    try:
        return wanted.expanduser().resolve() == Path(state.source).resolve()
    except (OSError, RuntimeError):  # links in a circle
        return False


def _asks_for(link: SavedSession, state: ViewState) -> bool:
    """Whether a link leads to what is shown already, scene and camera aside."""
    now = SavedSession.of(state)
    names = "query_id", "database_id", "method", "params", "options", "reference"
    return _has_open(link, state) and all(getattr(link, k) == getattr(now, k) for k in names)


def _say_copied(page: viser.ClientHandle, said: Copied) -> None:
    if said.copied:
        tell(page, "Link copied", "Whoever opens it on this viewer sees what you see.")
    else:
        tell(page, "The link was not copied", "Copy it from the tab Save.")
