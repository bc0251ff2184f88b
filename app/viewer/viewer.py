"""The server: gives each page that comes a session."""

import contextlib
import io
import threading
from collections.abc import Callable
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Literal, TypeAlias

import viser

from app.viewer.server.admission import Admission
from app.viewer.server.guard import open_server
from app.viewer.server.host import PANEL_WIDTH, has_private_session, pages, set_theme
from app.viewer.server.limits import READ_ALL, Limits, Permissions
from app.viewer.server.memory import (
    MEMO_SHARE,
    UNFINISHED_SHARE,
    MemoryKeeper,
    default_budget,
)
from app.viewer.session.jobs import Capacity
from app.viewer.widgets.bridge import page_script
from gpgrad_core.detection import PipelineParams, resolve_parameters
from gpgrad_core.params import preferred_parameters
from gpgrad_core.run import Cancelled, Progress
from gpgrad_core.run.folders import TemporaryFolder
from gpgrad_core.run.helper import start_helper
from gpgrad_core.run.memo import Memo
from gpgrad_core.run.store import Store
from gpgrad_core.run.threads import single_threaded_libraries
from gpgrad_core.types import Dataset, Submap

# A page is served before these are loaded, which takes a second.
if TYPE_CHECKING:
    from app.viewer.features.session import Session
    from app.viewer.features.world.scene import FirstGround
    from app.viewer.session.session_file import Opened, SavedSession

EVERYWHERE = ("0.0.0.0", "::")
"""Hosts that stand for all addresses of the machine."""

Sharing: TypeAlias = Literal["shared", "separate"]
Opening: TypeAlias = "Callable[[Memo, OpeningProgress], Opened]"
"""Opens a dataset. The memo keeps its fits; progress may raise Cancelled."""

REPORT_EVERY = 0.01
"""The progress is shown anew once it has grown by this share of the whole."""
LONGEST_OPENING = 10.0
"""An opening that was cancelled is waited for at most so long [s]."""


class OpeningProgress:
    """Shows in the middle of every page how far it is, until there is a session to show."""

    def __init__(self, server: viser.ViserServer, memo: Memo, closed: threading.Event) -> None:
        """Show it; once closed, nothing is opened any more."""
        gui = server.gui
        gui.main_panel.dock_right()
        gui.main_panel.set_width(PANEL_WIDTH)
        self.memo = memo  # stores results of a submap
        self._server, self._closed = server, closed
        self._line = gui.add_html("")
        self._ground: FirstGround | None = None

    def __call__(self, words: str) -> Progress:
        """Show what is done next; returns where to report how far it is, which may cancel."""
        shown = 0.0
        self._say(words, shown)

        def report(fraction: float) -> None:
            nonlocal shown
            if self._closed.is_set():
                raise Cancelled
            if fraction - shown >= REPORT_EVERY:
                shown = fraction
                self._say(words, min(fraction, 1.0))

        return report

    def show(self, submap: Submap) -> None:
        """Show the ground of one more submap, while others are read and parameters are fitted."""
        from app.viewer.features.world.scene import FirstGround  # noqa: PLC0415 - loads slowly

        if self._ground is None:
            self._ground = FirstGround(self._server, self.memo)
        self._ground.add(submap)

    def remove(self) -> None:
        self._line.remove()
        self._server.flush()

    def _say(self, words: str, share: float) -> None:
        values = {"WORDS": f"{words} …", "SHARE": share, "LOW": self._ground is not None}
        self._line.content = page_script("opening.js", **values)


class Viewer:
    """Serves one session to all pages, which then show the same, or one to each."""

    def __init__(
        self,
        dataset: "Dataset | Opening",
        params: PipelineParams | None = None,
        host: str = "127.0.0.1",
        port: int = 8080,
        *,
        source: str = "",
        saved: "SavedSession | None" = None,
        sessions: Sharing = "shared",
        permissions: Permissions = READ_ALL,
        admission: Admission | None = None,
        limits: Limits | None = None,
        store: Store | None = None,
        memory: int | None = None,
        on_full: Callable[[str], None] | None = None,
    ) -> None:
        """Start serving; returns at once.

        Something that opens a dataset is called in a thread of its own, and pages show how far it
        is; what it raises is raised by `run_forever`. It starts with ``params`` and resets to them;
        None takes what the dataset prefers, and what is automatic is fitted to it. ``saved`` is
        what to begin with in place of that. ``source`` is the path of the dataset, for the box in
        which it can be changed. If the port is taken, the next free one is used, and 0 takes any.

        In "shared" sessions all pages see and change the same, unless one chooses to work alone
        from there; a "separate" one ends with its page. The store keeps the fits of datasets for
        later runs. The memory is a budget for this process and its helper together [bytes]; when it
        cannot be met, ``on_full`` is called once, with a sentence.
        """
        budget = default_budget() if memory is None else memory
        self._memo = Memo(round(MEMO_SHARE * budget), store)
        opened = None
        if not callable(dataset):
            from app.viewer.session.session_file import Opened  # noqa: PLC0415

            asked = preferred_parameters(dataset, PipelineParams()) if params is None else params
            used = resolve_parameters(dataset.submaps, asked, self._memo)
            opened = Opened(dataset, asked, source, saved, used)
        self._opened = opened
        max_unfinished = round(UNFINISHED_SHARE * budget)
        max_upload = min(permissions.max_upload, max_unfinished)
        limits = replace(
            limits or Limits(), unfinished_bytes=max_unfinished, upload_bytes=max_upload
        )
        self._server, self._access = open_server(host, port, admission, limits)
        self._access.unfinished.on_full = on_full
        self._access.title = Path(source).name if callable(dataset) else dataset.name
        set_theme(self._server)
        self._quiet = contextlib.ExitStack()
        self._uploads = TemporaryFolder("gpgrad-uploads-")
        self._permissions = replace(
            permissions, uploads=Path(self._uploads.name), max_upload=max_upload
        )
        self._capacity = Capacity(helper=start_helper())
        self._memory = MemoryKeeper(
            budget,
            self._memo,
            self._capacity.helper,
            on_full,
            lambda: self._access.unfinished.num_bytes,
        )
        self._lock = threading.Lock()
        self._num_leaving = 0
        self._left = threading.Condition(self._lock)
        self._closed = threading.Event()
        self._is_shared = sessions == "shared"
        self._shared: Session | None = None
        self._separate: dict[int, Session] = {}
        self._ready = threading.Event()
        self._failure: BaseException | None = None
        self._opener: threading.Thread | None = None
        self._access.on_refused = self._show_refused_value
        self._access.uploads.on_refused = self._show_refused_upload
        if callable(dataset):
            stage = OpeningProgress(self._server, self._memo, self._closed)
            self._opener = threading.Thread(
                target=self._open, args=(dataset, stage), name="opening", daemon=True
            )
            self._opener.start()
        else:
            self._be_quiet()
            self._begin()
        self._server.on_client_connect(self._enter)
        self._server.on_client_disconnect(self._leave)

    @property
    def url(self) -> str:
        host = self._server.get_host()
        shown = "localhost" if host in EVERYWHERE else f"[{host}]" if ":" in host else host
        return f"http://{shown}:{self._server.get_port()}"

    @property
    def link(self) -> str:
        """Address that lets in whoever has it: with the token, if one is required."""
        token = self._access.admission.token
        return self.url if token is None else f"{self.url}/?token={token}"

    @property
    def memory(self) -> int:
        return self._memory.budget

    @property
    def sessions(self) -> "tuple[Session, ...]":
        """The shared session, if there is one; then those of single pages, the oldest first."""
        with self._lock:
            shared = () if self._shared is None else (self._shared,)
            return (*shared, *self._separate.values())

    def run_forever(self) -> None:
        """Serve until `close` or Ctrl-C; raises what was raised while opening the dataset."""
        while not self._closed.wait(0.5 if self._ready.is_set() else 0.05):
            if self._failure is not None:
                raise self._failure

    def wait_idle(self, timeout: float = 60.0) -> bool:
        """Wait until all pictures are up to date; says whether that came true in time [s]."""
        return self._ready.wait(timeout) and all(
            session.wait_idle(timeout) for session in self.sessions
        )

    def close(self) -> None:
        if self._closed.is_set():
            return
        self._closed.set()
        if self._opener is not None:
            self._opener.join(LONGEST_OPENING)
        for session in self.sessions:
            session.close()
        with self._left:  # those whose pages have just gone must have ended too
            self._left.wait_for(lambda: not self._num_leaving)
        with contextlib.redirect_stdout(io.StringIO()):
            self._server.stop()
        self._memory.close()
        if self._capacity.helper is not None:
            self._capacity.helper.close()
        self._uploads.cleanup()
        self._quiet.close()

    def _open(self, opening: Opening, stage: OpeningProgress) -> None:
        """Open the dataset, and begin; pages come and go meanwhile."""
        # The modules of a session are loaded while its dataset is read and fitted.
        modules = ("app.viewer.features.session",)
        threading.Thread(target=import_module, args=modules, name="loading", daemon=True).start()
        try:
            self._be_quiet()
            self._opened = opening(self._memo, stage)
            stage("Preparing the picture")(0.0)
            stage.remove()
            self._begin()
        except Cancelled:
            pass
        except BaseException as error:
            self._failure = error

    def _be_quiet(self) -> None:
        """Let libraries work in one thread each: others spin on, on the helper's processor."""
        self._quiet.enter_context(single_threaded_libraries())

    def _begin(self) -> None:
        """Make the session of all pages, or those of the pages that are there."""
        from app.viewer.features.session import Session  # noqa: PLC0415

        assert self._opened is not None
        if self._is_shared:
            self._shared = Session(
                self._server, self._opened, self._memo, self._capacity, self._permissions
            )
        self._ready.set()
        for client in self._server.get_clients().values():
            self._enter(client)

    # Called from the server's pool of threads, so in any order.

    def _enter(self, client: viser.ClientHandle) -> None:
        is_separate = not self._is_shared or has_private_session(self._server, client.client_id)
        if is_separate and self._ready.is_set():
            self._begin_separate(client)
        self._count()

    def _begin_separate(self, client: viser.ClientHandle) -> None:
        from app.viewer.features.session import Session  # noqa: PLC0415

        opened = self._opened if self._shared is None else self._shared.desk.present()
        assert opened is not None
        with self._lock:
            if client.client_id in self._separate:
                return
            if self._closed.is_set() or client.client_id not in self._server.get_clients():
                return  # it left before its turn came
            if self._is_shared:
                set_theme(client)  # it did not receive what all others did
            self._separate[client.client_id] = Session(
                client, opened, self._memo, self._capacity, self._permissions
            )

    def _leave(self, client: viser.ClientHandle) -> None:
        with self._lock:
            session = self._separate.pop(client.client_id, None)
            self._num_leaving += session is not None
        self._count()
        if session is None:
            return
        try:
            session.close()
        finally:
            with self._left:
                self._num_leaving -= 1
                self._left.notify_all()

    def _session_of(self, page: int) -> "Session | None":
        with self._lock:
            return self._separate.get(page) or self._shared

    def _show_refused_value(self, page: int, text: str) -> None:
        if session := self._session_of(page):
            session.pair.refuse(text)

    def _show_refused_upload(self, page: int, text: str) -> None:
        if session := self._session_of(page):
            session.data.refuse(text)

    def _count(self) -> None:
        with self._lock:  # so that the last to count is the last to tell
            if self._shared is None or self._closed.is_set():
                return  # there is nobody to tell
            together, alone = len(pages(self._server)), len(self._separate)
            for session in (self._shared, *self._separate.values()):
                session.show_presence(together, alone)
