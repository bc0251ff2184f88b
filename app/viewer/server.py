"""The server: gives each page that comes a session."""

import contextlib
import io
import threading
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Literal, TypeAlias

import viser

from app.viewer.capacity import Capacity
from app.viewer.door.admission import Admission
from app.viewer.door.limits import Limits
from app.viewer.door.server import Told, open_server
from app.viewer.host import set_theme
from app.viewer.memory import MEMO_SHARE, MemoryKeeper, default_budget
from app.viewer.opened import Opened
from app.viewer.permissions import READ_ALL, Permissions
from app.viewer.session import Session
from app.viewer.session_file import SavedSession
from gpgrad_core.params.files import preferred_parameters
from gpgrad_core.pipeline import PipelineParams, resolve_parameters
from gpgrad_core.run.helper import start_helper
from gpgrad_core.run.memo import Memo
from gpgrad_core.run.store import Store
from gpgrad_core.run.threads import single_threaded_libraries
from gpgrad_core.run.whole import TemporaryFolder
from gpgrad_core.types import Dataset

EVERYWHERE = ("0.0.0.0", "::")
"""Hosts that stand for all addresses of the machine."""

Sharing: TypeAlias = Literal["shared", "separate"]


class Viewer:
    """Serves one session to all pages, which then show the same, or one to each."""

    def __init__(
        self,
        dataset: Dataset,
        params: PipelineParams | None = None,
        host: str = "127.0.0.1",
        port: int = 8080,
        *,
        source: str = "",
        saved: SavedSession | None = None,
        sessions: Sharing = "shared",
        permissions: Permissions = READ_ALL,
        admission: Admission | None = None,
        limits: Limits | None = None,
        store: Store | None = None,
        memory: int | None = None,
        on_full: Callable[[str], None] | None = None,
    ) -> None:
        """Start serving; returns at once.

        Args:
            dataset: What to open with.
            params: What to start with and to reset to; None takes what the dataset prefers. What is
                automatic is fitted to the dataset.
            host: Address to listen on. If other machines can reach it, everybody must bring the
                token that `link` ends with.
            port: Port to listen on; if it is taken, the next free one. 0 takes any.
            source: Path of the dataset, for the box in which it can be changed.
            saved: What to begin with in place of that.
            sessions: "shared": all pages see and change the same. "separate": each page has a
                session of its own, which ends with it; what one has computed serves all.
            permissions: What pages may have read and written; uploads get a folder that ends with
                the viewer.
            admission: Who may come in; None lets in the viewer's own pages only, with a token where
                other machines can reach the host.
            limits: How much pages may ask.
            store: Keeps the fits of datasets for later runs.
            memory: Budget for this process and its helper together [bytes]; None takes a share of
                the machine's.
            on_full: Told once, in a sentence, when the budget cannot be kept.

        Raises:
            InputError: If the dataset prefers parameters that there are not.
        """
        # For as long as it serves: a BLAS that has worked in several threads lets them spin for
        # many milliseconds more, on the processor that the helper needs.
        self._quiet = contextlib.ExitStack()
        self._quiet.enter_context(single_threaded_libraries())
        start = params if params is not None else preferred_parameters(dataset, PipelineParams())
        budget = default_budget() if memory is None else memory
        self._memo = Memo(round(MEMO_SHARE * budget), store)
        used = resolve_parameters(dataset.submaps, start, self._memo)
        self._opened = Opened(dataset, start, source, saved, used)
        self._uploads = TemporaryFolder("gpgrad-uploads-")
        self._permissions = replace(permissions, uploads=Path(self._uploads.name))
        self._capacity = Capacity(helper=start_helper())
        self._memory = MemoryKeeper(budget, self._memo, self._capacity.helper, on_full)
        self._lock = threading.Lock()
        self._num_leaving = 0
        self._left = threading.Condition(self._lock)
        self._closed = threading.Event()
        self._server, self._door = open_server(
            host, port, admission, max_upload=self._permissions.max_upload, limits=limits
        )
        set_theme(self._server, dark=False)
        self._shared: Session | None = None
        self._separate: dict[int, Session] = {}
        if sessions == "shared":
            self._shared = Session(
                self._server, self._opened, self._memo, self._capacity, self._permissions
            )
        self._door.told = Told(self._say_refused, self._say_upload_refused)
        self._server.on_client_connect(self._enter)
        self._server.on_client_disconnect(self._leave)

    @property
    def url(self) -> str:
        """Address of the page, without the token."""
        host = self._server.get_host()
        shown = "localhost" if host in EVERYWHERE else f"[{host}]" if ":" in host else host
        return f"http://{shown}:{self._server.get_port()}"

    @property
    def link(self) -> str:
        """Address that lets in whoever has it: with the token, if one is asked for."""
        token = self._door.gate.token
        return self.url if token is None else f"{self.url}/?token={token}"

    @property
    def memory(self) -> int:
        """The budget for this process and its helper together [bytes]."""
        return self._memory.budget

    @property
    def sessions(self) -> tuple[Session, ...]:
        """The shared session; else those of the pages that are open, the oldest first."""
        if self._shared is not None:
            return (self._shared,)
        with self._lock:
            return tuple(self._separate.values())

    def run_forever(self) -> None:
        """Serve until `close` or Ctrl-C (KeyboardInterrupt)."""
        while not self._closed.wait(0.5):
            pass

    def wait_idle(self, timeout: float = 60.0) -> bool:
        """Wait until all pictures are up to date; says whether that came true in time [s]."""
        return all(session.wait_idle(timeout) for session in self.sessions)

    def close(self) -> None:
        """Stop working and serving."""
        if self._closed.is_set():
            return
        self._closed.set()
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

    # Called from the server's pool of threads, so in any order.

    def _enter(self, client: viser.ClientHandle) -> None:
        if self._shared is not None:
            self._count()
            return
        with self._lock:
            if self._closed.is_set() or client.client_id not in self._server.get_clients():
                return  # it left before its turn came
            self._separate[client.client_id] = Session(
                client, self._opened, self._memo, self._capacity, self._permissions
            )

    def _leave(self, client: viser.ClientHandle) -> None:
        if self._shared is not None:
            self._count()
            return
        with self._lock:
            session = self._separate.pop(client.client_id, None)
            if session is None:
                return
            self._num_leaving += 1
        try:
            session.close()
        finally:
            with self._left:
                self._num_leaving -= 1
                self._left.notify_all()

    def _session_of(self, page: int) -> Session | None:
        """Give the session that a page shows, if it has one yet."""
        with self._lock:
            return self._shared or self._separate.get(page)

    def _say_refused(self, page: int, text: str) -> None:
        session = self._session_of(page)
        if session is not None:
            session.pair.refuse(text)

    def _say_upload_refused(self, page: int, text: str) -> None:
        session = self._session_of(page)
        if session is not None:
            session.data.refuse(text)

    def _count(self) -> None:
        assert self._shared is not None
        with self._lock:  # so that the last to count is the last to tell
            if self._closed.is_set():
                return  # there is nobody left to tell
            self._shared.show_presence(len(self._server.get_clients()))
