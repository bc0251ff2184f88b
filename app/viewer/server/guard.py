"""viser's server with access control: every connection and every message passes here first.

viser gives `websockets.serve` neither a check of hosts and origins nor of what comes in, and has
no place to put one. So the call that it makes is wrapped while it starts, and the connections that
it gets are of a class that reads messages before viser does. `open_server` refuses to serve at all
if access control was not put in.
"""

import asyncio
import contextlib
import dataclasses
import functools
import gzip
import inspect
import io
import logging
import threading
from collections import ChainMap
from collections.abc import Awaitable, Callable, Generator, Hashable
from html import escape
from http import HTTPStatus
from typing import Any, cast

import msgspec
import viser
import websockets.asyncio.server
from websockets.asyncio.server import ServerConnection
from websockets.frames import DATA_OPCODES, Frame
from websockets.http11 import Request, Response
from websockets.protocol import State

from app.viewer.server.admission import Admission
from app.viewer.server.host import ALONE, has_private_session
from app.viewer.server.inputs import (
    RefusedValue,
    checked_value,
    is_small_enough,
    read_message,
)
from app.viewer.server.internals import (
    connections_of,
    containers_of,
    group_of,
    inputs_of,
    messages,
    send_to,
    spare_from_broadcasts,
    state_of,
)
from app.viewer.server.limits import CoalescingQueue, Limits, RoundRobin
from app.viewer.server.uploads import Unfinished, Uploads
from app.viewer.web import dress, fill_page_file

_starting = threading.Lock()

GOING = 3.0
"""Time that a connection has to end in order [s]."""
MOST_WAITING_BYTES = 1_000_000
"""From so much on, two parts of a file, nothing more of a page is read before its turn."""
FRAME_BYTES = 200
"""What `websockets` holds of a piece of a message beside its content; measured: 172."""


class AccessControl:
    """Lets pages in, and decides on each message."""

    def __init__(self, admission: Admission, limits: Limits) -> None:
        self.admission = admission  # decides who comes in
        self.limits = limits
        self.is_open = False  # whether viser serves through it
        self.title = ""  # what stands in the middle of a page until there is a session to show
        # called with the page and a sentence for its user, of a value
        self.on_refused: Callable[[int, str], None] = lambda _page, _text: None
        # counts what pages have begun to send
        self.unfinished = Unfinished(limits.unfinished_bytes)
        # receives the files among that
        self.uploads = Uploads(limits, self.unfinished, self._client)
        self.turns = RoundRobin()  # lets pages act one after the other
        # by page and widget: what is refused soon, unless the person goes on typing
        self.refusals_due: dict[tuple[int, str], asyncio.TimerHandle] = {}
        self._server: Any = None

    def guard(self, server: viser.ViserServer) -> None:
        spare_from_broadcasts(server, lambda page: has_private_session(server, page))
        self._server = server

    def serve(self, original: Callable[..., Any], *args: Any, **options: Any) -> Any:
        """Stand in for `websockets.asyncio.server.serve`, which viser calls."""
        answer: Callable[..., Any] | None = options.get("process_request")
        logger = logging.getLogger(f"{__name__}.connection")
        logger.addFilter(_is_worth_saying)
        self.is_open = answer is not None
        return original(
            *args,
            **options
            | {
                "process_request": functools.partial(self._answer, answer),
                "create_connection": functools.partial(Connection, self),
                "max_size": self.limits.message_bytes,
                "max_queue": 16,
                "close_timeout": GOING,
                "logger": logger,
            },
        )

    async def _answer(
        self, answer: Callable[..., Any] | None, connection: ServerConnection, request: Request
    ) -> Response | None:
        reached = cast("tuple[Any, ...]", connection.local_address)
        address = str(reached[0]), int(reached[1])
        wanted = bool(request.headers.get_all("Upgrade"))
        refusal = self.admission.refusal(
            request.headers.get_all, request.path, address, socket_wanted=wanted
        )
        if refusal is not None:
            return connection.respond(*refusal)
        pages = sum(peer.protocol.state is State.OPEN for peer in connection.server.handlers)
        if wanted and pages >= self.limits.pages:
            return connection.respond(
                HTTPStatus.SERVICE_UNAVAILABLE,
                f"{self.limits.pages} pages are open, which is the most.\n",
            )
        while wanted and self._server is None:  # viser listens before it is ready
            await asyncio.sleep(0.01)
        asked = request
        if _is_alone(request):  # it is the same page
            asked = dataclasses.replace(request, path=request.path.removeprefix(ALONE))
        try:
            response = None if answer is None else answer(connection, asked)
            if inspect.isawaitable(response):
                response = await cast("Awaitable[Response | None]", response)
        except (OSError, ValueError):  # too long a path, or one with a zero byte
            return connection.respond(HTTPStatus.NOT_FOUND, "There is no such page.\n")
        if response is not None:
            given = self.admission.answer_headers(request.headers.get_all, address[1])
            for name, value in given.items():
                response.headers[name] = value
            _add_scripts(response, self.title)
        return response

    def page_of(self, connection: ServerConnection) -> int:
        live = connections_of(self._server)
        return next(number for number, peer in live.items() if peer is connection)

    def key_of(self, page: int, message: dict[str, Any]) -> Hashable | None:
        """Name what a message sets, if a newer value may take its place; None for all else."""
        match message["type"]:
            case "ViewerCameraMessage":
                return "camera"
            case "TransformControlsUpdateMessage":
                return "handles", message["name"]
            case "GuiUpdateMessage":
                widget = self._widget(page, message["uuid"])
                if widget is None or state_of(widget).is_button:
                    return None
                try:  # a value that cannot be takes no other's place
                    checked_value(widget, message["updates"])
                except RefusedValue:
                    return None
                return message["uuid"]
            case _:
                return None

    def on_message(self, page: int, message: dict[str, Any]) -> bool:
        """Whether viser may have a message; corrects what is barely beyond bounds in it."""
        match message["type"]:
            case "GuiUpdateMessage":
                return self._takes_value(page, message)
            case "FileTransferStartUpload":
                button = self._widget(page, message["source_component_uuid"])
                if isinstance(button, viser.GuiUploadButtonHandle) and self._offers(page, button):
                    self.uploads.start(page, button, message)
                return False
            case "FileTransferPart":
                self.uploads.add_part(page, message)
                return False
            case "GetRenderResponseMessage":
                return is_small_enough(message["payload"])
            case _:
                return True

    def leave(self, page: int) -> None:
        self.uploads.leave(page)
        for key in [key for key in self.refusals_due if key[0] == page]:
            self.refusals_due.pop(key).cancel()

    def _takes_value(self, page: int, message: dict[str, Any]) -> bool:
        uuid, updates = message["uuid"], message["updates"]
        widget = self._widget(page, uuid)
        if widget is None:
            return False
        due = self.refusals_due.pop((page, uuid), None)
        if due is not None:
            due.cancel()  # the person was still typing
        if not self._offers(page, widget):  # the page has not heard of it yet, or forges it
            self._show_value(page, widget)
            return False
        try:
            updates["value"] = checked_value(widget, updates)
        except RefusedValue as refused:
            self.refusals_due[page, uuid] = asyncio.get_running_loop().call_later(
                self.limits.typing_seconds, self._put_back, page, widget, str(refused)
            )
            return False
        return True

    def _put_back(self, page: int, widget: Any, reason: str) -> None:
        """Show the page what the widget is, and say why it is not what the page wants."""
        del self.refusals_due[page, state_of(widget).uuid]
        self._show_value(page, widget)
        self.on_refused(page, f"{getattr(widget, 'label', 'This')}: {reason}")

    def _show_value(self, page: int, widget: Any) -> None:
        state, client = state_of(widget), self._client(page)
        if client is not None and not state.is_button:
            send_to(client, messages.GuiUpdateMessage(state.uuid, {"value": state.value}))

    def _offers(self, page: int, widget: Any) -> bool:
        """Whether a page shows a usable widget; what it may have folded counts as shown."""
        containers = ChainMap(*map(containers_of, self._hosts(page)))
        offered = not getattr(widget, "disabled", True)  # a bar of progress only shows
        inner, around = widget, ""
        while offered and around != "root":
            inner = group_of(inner)
            around = state_of(inner).parent_container_id
            offered = getattr(inner, "visible", True) and around in containers
            inner = containers.get(around)
        return offered

    def _widget(self, page: int, uuid: str) -> Any:
        """Find a widget that a page may change; None if there is none."""
        return ChainMap(*map(inputs_of, self._hosts(page))).get(uuid)

    def _hosts(self, page: int) -> list[Any]:
        """Whose widgets a page sees: those of all pages, and its own."""
        client = self._client(page)
        return [self._server, *([] if client is None else [client])]

    def _client(self, page: int) -> viser.ClientHandle | None:
        return self._server.get_clients().get(page)


class Connection(ServerConnection):
    """One connection: a page, or what may become one; its messages are checked first."""

    @property
    def is_alone(self) -> bool:
        """Whether it is that of a page that is to have a session of its own."""
        return self.request is not None and _is_alone(self.request)

    def __init__(self, access: AccessControl, *args: Any, **options: Any) -> None:
        super().__init__(*args, **options)
        self._access = access
        self._page: int | None = None
        self._assembled = 0  # bytes of the pieces of messages that are not whole, or not read
        self._inbox = CoalescingQueue()
        self._rested = 0.0  # when the page may have its next turn, by the event loop's clock [s]

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Accept a connection; the oldest that has not become a page makes room for it."""
        super().connection_made(transport)
        waiting = [peer for peer in self.server.handlers if peer.protocol.state is not State.OPEN]
        for oldest in waiting[: -self._access.limits.waiting]:
            oldest.transport.abort()

    def connection_lost(self, exc: Exception | None) -> None:
        super().connection_lost(exc)
        self._access.unfinished.hold(self, 0)
        if self._page is not None:
            self._access.leave(self._page)

    def data_received(self, data: bytes) -> None:
        """Process what came, and check that there is room."""
        super().data_received(data)
        self._hold()

    def process_event(self, event: Any) -> None:
        if isinstance(event, Frame) and event.opcode in DATA_OPCODES:
            self._assembled += len(event.data) + FRAME_BYTES
        super().process_event(event)

    def _hold(self) -> None:
        """Report how much of what the page sends is not acted on yet; it may have to end."""
        if not self.transport.is_closing():
            rest = len(self.protocol.reader.buffer)
            held = rest + self._assembled + self._inbox.num_bytes
            self._access.unfinished.hold(self, held, self.transport.abort)

    async def recv(self, decode: bool | None = None) -> Any:
        """Return the next message that viser may have, when it is the page's turn."""
        del decode  # all are bytes
        if self._page is None:
            self._page = self._access.page_of(self)
        loop, limits = asyncio.get_running_loop(), self._access.limits
        while True:
            if not self._inbox:
                await self._read(self._page)
            await asyncio.sleep(self._rested - loop.time())
            await self._access.turns.wait()
            self._rested = loop.time() + 1 / limits.rate
            for _ in range(limits.messages - len(self._inbox)):
                if self._has_whole_message() and self._inbox.num_bytes < MOST_WAITING_BYTES:
                    await self._read(self._page)
            message = self._inbox.take()
            self._hold()
            if message is not None and self._access.on_message(self._page, message):
                return msgspec.msgpack.encode(message)

    async def _read(self, page: int) -> None:
        """Read a message, and merge it with those that wait."""
        frame = await super().recv()
        waiting = self.recv_messages.frames.queue
        self._assembled = sum(len(piece.data) + FRAME_BYTES for piece in waiting)
        message = read_message(frame)
        if message is not None:
            self._inbox.put(self._access.key_of(page, message), message, len(frame))
        self._hold()

    def _has_whole_message(self) -> bool:
        return any(piece.fin for piece in self.recv_messages.frames.queue)


def open_server(
    host: str, port: int, admission: Admission | None = None, limits: Limits | None = None
) -> tuple[viser.ViserServer, AccessControl]:
    """Start viser's server with access control, or not at all; on the next free port if need be."""
    access = AccessControl((admission or Admission()).at(host), limits or Limits())
    # viser prints a box with its addresses; the command line says ours.
    with contextlib.redirect_stdout(io.StringIO()), _wrapped(access):
        server = viser.ViserServer(host=host, port=port, verbose=False)
    if not access.is_open:
        server.stop()
        raise RuntimeError(
            f"viser {viser.__version__} cannot be guarded: it does not call websockets' serve "
            "as before"
        )
    access.guard(server)
    return server, access


@contextlib.contextmanager
def _wrapped(access: AccessControl) -> Generator[None]:
    """Insert it between viser and `websockets` while a server starts, which is when it calls."""
    module: Any = websockets.asyncio.server
    with _starting:
        original = module.serve
        module.serve = functools.partial(access.serve, original)
        try:
            yield
        finally:
            module.serve = original


def _is_alone(request: Request) -> bool:
    return request.path.partition("?")[0] == ALONE


def _is_worth_saying(record: logging.LogRecord) -> bool:
    """Whether to log a record: not a request that was begun and not ended."""
    return record.getMessage() not in ("opening handshake failed", "connection rejected (200 OK)")


# viser's client makes the address of its websocket from that of the page and cuts off only what
# follows `?`. A socket's address may have no `#`, so a page that was opened with one and without
# the other never connects. And as the client starts it writes the page's address anew, at times
# without that part, which our links need. Its labels suit no dark page, and its page is white
# until its server has set it. So scripts and colours stand before all others.


SCRIPTS = ("keep_hash.js", "labels.js", "theme.js", "notice.js")


def _add_scripts(response: Response, title: str) -> None:
    """Insert the scripts and styles into an answer, if that is the page."""
    if response.headers.get("Content-Type", "").startswith("text/html"):
        zipped = response.headers.get("Content-Encoding") == "gzip"
        response.body = _with_scripts(bytes(response.body or b""), title, zipped=zipped)
        del response.headers["Content-Length"]  # else it would be there twice
        response.headers["Content-Length"] = str(len(response.body))


@functools.lru_cache(maxsize=2)  # as it is, and zipped
def _with_scripts(body: bytes, title: str, *, zipped: bool) -> bytes:
    opening = fill_page_file("opening.html", NAME=escape(title)) if title else ""
    page = dress((gzip.decompress(body) if zipped else body).decode(), SCRIPTS, opening).encode()
    return gzip.compress(page) if zipped else page
