"""viser's server with a door: every connection and every message passes here first.

viser gives `websockets.serve` neither a check of hosts and origins nor of what comes in, and has
no place to put one. So the call that it makes is wrapped while it starts, and the connections that
it gets are of a class that reads messages before viser does. All that this module uses of viser
beyond its public interface stands here; ``tests/app/viewer/server/test_viser.py`` fails when it
changes, and `open_server` refuses to serve at all if the door was not put in.
"""

import asyncio
import contextlib
import functools
import gzip
import inspect
import io
import logging
import threading
from collections.abc import Awaitable, Callable, Generator
from dataclasses import dataclass
from http import HTTPStatus
from typing import Any, TypeAlias, cast

import viser
import websockets.asyncio.server
from viser import _messages as messages
from websockets.asyncio.server import ServerConnection
from websockets.http11 import Request, Response
from websockets.protocol import State

from app.viewer.server.admission import Admission, Gate
from app.viewer.server.inputs import Malformed, is_small_enough, read_message, why_not
from app.viewer.server.limits import Limits, Pace, RefusedUpload, Uploads
from app.viewer.web import fill_page_file

_log = logging.getLogger(__name__)
_starting = threading.Lock()

Tell: TypeAlias = Callable[[int, str], None]
"""Given the number of a page and a sentence for the person at it; called in the event loop."""
Answer: TypeAlias = Callable[[ServerConnection, Request], Any]

GOING = 3.0
"""Time that a connection has to end in order [s]."""


def nobody(page: int, text: str) -> None:
    """Tell nobody; the default."""


@dataclass(eq=False)
class Told:
    """Who is told what was refused; set once there is somebody.

    Attributes:
        value: Of values that a widget cannot have.
        upload: Of files.
    """

    value: Tell = nobody
    upload: Tell = nobody


class Door:
    """Lets pages in, reads what they say, and counts what they send.

    Attributes:
        gate: Decides who comes in.
        told: Who is told what was refused.
        uploads: Counts what pages are sending.
        refusals_due: By page and widget: what is refused soon, unless the person goes on typing.
        is_open: Whether viser serves through it.
    """

    def __init__(self, gate: Gate, limits: Limits, max_upload: int) -> None:
        """Put up the door; `open_server` puts it in."""
        self.gate = gate
        self.told = Told()
        self.is_open = False
        self.limits = limits
        self.uploads = Uploads(max_upload, limits)
        self._server: Any = None
        self._sweep: asyncio.TimerHandle | None = None
        self.refusals_due: dict[tuple[int, str], asyncio.TimerHandle] = {}

    def guard(self, server: viser.ViserServer) -> None:
        """Take the server whose pages come through the door."""
        self._server = server

    def serve(self, original: Callable[..., Any], *args: Any, **options: Any) -> Any:
        """Stand in for `websockets.asyncio.server.serve`, which viser calls."""
        answer: Answer | None = options.get("process_request")
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
                "max_queue": 4,
                "close_timeout": GOING,
                "logger": logger,
            },
        )

    async def _answer(
        self, answer: Answer | None, connection: ServerConnection, request: Request
    ) -> Response | None:
        """Answer a request: refuse it, or let viser answer it."""
        reached = cast("tuple[Any, ...]", connection.local_address)
        address = str(reached[0]), int(reached[1])
        wanted = bool(request.headers.get_all("Upgrade"))
        refusal = self.gate.refusal(
            request.headers.get_all, request.path, address, socket_wanted=wanted
        )
        if refusal is not None:
            return connection.respond(refusal.status, refusal.text)
        pages = sum(peer.protocol.state is State.OPEN for peer in connection.server.handlers)
        if wanted and pages >= self.limits.pages:
            return connection.respond(
                HTTPStatus.SERVICE_UNAVAILABLE,
                f"{self.limits.pages} pages are open, which is the most.\n",
            )
        response = None if answer is None else answer(connection, request)
        if inspect.isawaitable(response):
            response = await cast("Awaitable[Response | None]", response)
        if response is not None:
            given = self.gate.answer_headers(request.headers.get_all, request.path, address[1])
            for name, value in given.items():
                response.headers[name] = value
            _add_script(response)
        return response

    # What pages say.

    async def lets_pass(self, connection: "Connection", frame: object) -> bool:
        """Read a frame before viser does; says whether viser may have it.

        Raises:
            Malformed: If it is no message.
        """
        while self._server is None:  # viser listens before it has made all that it needs
            await asyncio.sleep(0.01)
        page, message = connection.page(self._server), read_message(frame)
        if message is None or page is None:
            return False
        match message["type"]:
            case "GuiUpdateMessage":
                return self._takes_value(page, message)
            case "FileTransferStartUpload":
                return self._takes_upload(page, message)
            case "FileTransferPart":
                return self._takes_part(page, message)
            case "GetRenderResponseMessage":
                return is_small_enough(message["payload"])
            case _:
                return True

    def leave(self, page: int) -> None:
        """Forget a page that has left."""
        for name in self.uploads.leave(page):
            self._forget_upload(page, name)
        for key in [key for key in self.refusals_due if key[0] == page]:
            self.refusals_due.pop(key).cancel()

    # Widgets.

    def _takes_value(self, page: int, message: dict[str, Any]) -> bool:
        widget = self._widget(page, message["uuid"])
        if widget is None:
            return False
        key = page, message["uuid"]
        if (
            key in self.refusals_due
        ):  # what it said before is forgotten: the person was still typing
            self.refusals_due.pop(key).cancel()
        reason = why_not(widget, message["updates"])
        if reason is not None:
            loop = asyncio.get_running_loop()
            self.refusals_due[key] = loop.call_later(
                self.limits.typing_seconds, self._put_back, page, widget, reason
            )
        return reason is None

    def _put_back(self, page: int, widget: Any, reason: str) -> None:
        """Show the page what the widget is, and say why it is not what the page wants."""
        del self.refusals_due[page, widget._impl.uuid]
        value = widget._impl.value
        if not isinstance(value, viser.UploadedFile):
            self._say(page, messages.GuiUpdateMessage(widget._impl.uuid, {"value": value}))
        self.told.value(page, f"{getattr(widget, 'label', 'This')}: {reason}")

    def _widget(self, page: int, uuid: str) -> Any:
        """Find a widget that a page may change; None if there is none."""
        for gui in self._guis(page):
            widget = gui._gui_input_handle_from_uuid.get(uuid)
            if widget is not None:
                return None if widget._impl.removed else widget
        return None

    def _guis(self, page: int) -> list[Any]:
        """The widgets that all pages see, and those of the page's own."""
        client = self._server.get_clients().get(page)
        return [self._server.gui, *([] if client is None else [client.gui])]

    def _say(self, page: int, message: messages.Message) -> None:
        state = self._server._websock_server._client_state_from_id.get(page)
        if state is not None:
            state.message_buffer.push(message)

    # Files.

    def _takes_upload(self, page: int, message: dict[str, Any]) -> bool:
        button = self._widget(page, message["source_component_uuid"])
        if not isinstance(button, viser.GuiUploadButtonHandle):
            return False
        if not button.visible or button.disabled:
            return False
        try:
            self.uploads.start(page, message)
        except RefusedUpload as refused:
            self._refuse_upload(page, message, int(message["size_bytes"]), str(refused))
            return False
        self._wake()
        return True

    def _takes_part(self, page: int, message: dict[str, Any]) -> bool:
        try:
            return self.uploads.part(page, message)
        except RefusedUpload as refused:
            self._forget_upload(page, message["transfer_uuid"])
            self._refuse_upload(page, message, 1, str(refused))
            return False

    def _refuse_upload(self, page: int, message: dict[str, Any], size: int, text: str) -> None:
        """Take the page's notice of a running upload away, and say why."""
        source, transfer = message["source_component_uuid"], message["transfer_uuid"]
        self._say(page, messages.FileTransferPartAck(source, transfer, size, size))
        self.told.upload(page, text)

    def _forget_upload(self, page: int, transfer: str) -> None:
        for gui in self._guis(page):
            gui._current_file_upload_states.pop(transfer, None)

    def _wake(self) -> None:
        """Look after uploads until there are none."""
        if self._sweep is None:
            loop = asyncio.get_running_loop()
            self._sweep = loop.call_later(self.limits.idle_seconds / 4, self._clean)

    def _clean(self) -> None:
        """Forget uploads that have stopped, and what was told of those that have come.

        viser tells all pages, and those to come, of every part of every upload: for ever.
        """
        self._sweep = None
        for name in self.uploads.expire():
            for page in self._server.get_clients():
                self._forget_upload(page, name)
            self._server.gui._current_file_upload_states.pop(name, None)
        self._server._websock_server._broadcast_buffer.remove_from_buffer(_is_upload_news)
        if self.uploads.names:
            self._wake()


class Connection(ServerConnection):
    """One connection: a page, or what may become one; its messages pass the door first."""

    def __init__(self, door: Door, *args: Any, **options: Any) -> None:
        """Begin with nothing said.

        Args:
            door: That it came through.
            args: Of `ServerConnection`.
            options: Of it too.
        """
        super().__init__(*args, **options)
        self._door = door
        self._pace = Pace(door.limits.rate, door.limits.burst)
        self._page: int | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Take a connection; the oldest that has not become a page makes room for it."""
        super().connection_made(transport)
        waiting = [peer for peer in self.server.handlers if peer.protocol.state is not State.OPEN]
        for oldest in waiting[: -self._door.limits.waiting]:
            oldest.transport.abort()

    def connection_lost(self, exc: Exception | None) -> None:
        """Let go of what the page had under way."""
        super().connection_lost(exc)
        if self._page is not None:
            self._door.leave(self._page)

    def page(self, server: Any) -> int | None:
        """Give viser's number of the page; None before it has one."""
        if self._page is None:
            live = server._websock_server._live_connections
            self._page = next((number for number, peer in live.items() if peer is self), None)
        return self._page

    async def recv(self, decode: bool | None = None) -> Any:
        """Give the next message that viser may have; a frame that is none ends the connection."""
        while True:
            frame = await super().recv(decode)
            pause = self._pace.wait_seconds()
            if pause:
                await asyncio.sleep(pause)
            try:
                if await self._door.lets_pass(self, frame):
                    return frame
            except Malformed as error:
                await self.close(1008, f"not understood: {error}")


def open_server(
    host: str,
    port: int,
    admission: Admission | None = None,
    *,
    max_upload: int = 0,
    limits: Limits | None = None,
) -> tuple[viser.ViserServer, Door]:
    """Start viser's server behind a door.

    Args:
        host: Address to serve on.
        port: Port to serve on; if it is taken, the next free one. 0 takes any.
        admission: Who may come in.
        max_upload: Bytes of the largest file that may be uploaded, and of all at once.
        limits: Of pages, messages and times.

    Raises:
        RuntimeError: If this release of viser serves in another way than the door knows. Nothing
            is served then.
    """
    door = Door((admission or Admission()).at(host), limits or Limits(), max_upload)
    # viser prints a box with its addresses; the command line says ours.
    with contextlib.redirect_stdout(io.StringIO()), _wrapped(door):
        server = viser.ViserServer(host=host, port=port, verbose=False)
    if not door.is_open:
        server.stop()
        raise RuntimeError(
            f"viser {viser.__version__} cannot be guarded: it does not call websockets' serve "
            "as before"
        )
    door.guard(server)
    return server, door


@contextlib.contextmanager
def _wrapped(door: Door) -> Generator[None]:
    """Put the door between viser and `websockets` while a server starts, which is when it calls."""
    module: Any = websockets.asyncio.server
    with _starting:
        original = module.serve
        module.serve = functools.partial(door.serve, original)
        try:
            yield
        finally:
            module.serve = original


def forget_file(button: viser.GuiUploadButtonHandle, file: viser.UploadedFile) -> None:
    """Let go of a file that was taken in; viser keeps the last one of each button for ever."""
    handle: Any = button
    if handle._impl.value is file:
        handle._impl.value = viser.UploadedFile("", b"")


def _is_upload_news(message: object) -> bool:
    return isinstance(message, messages.FileTransferPartAck)


def _is_worth_saying(record: logging.LogRecord) -> bool:
    """Leave out of the log that somebody has begun a request and not ended it."""
    return record.getMessage() not in ("opening handshake failed", "connection rejected (200 OK)")


# viser's client makes the address of its websocket from that of the page and cuts off only what
# follows `?`. A socket's address may have no `#`, so a page that was opened with one and without
# the other never connects. And as the client starts it writes the page's address anew, at times
# without that part, which our links need. So a script stands before all others.


def _add_script(response: Response) -> None:
    """Put the script into an answer, if that is the page."""
    if response.headers.get("Content-Type", "").startswith("text/html"):
        zipped = response.headers.get("Content-Encoding") == "gzip"
        response.body = _with_script(bytes(response.body or b""), zipped=zipped)
        del response.headers["Content-Length"]  # else it would be there twice
        response.headers["Content-Length"] = str(len(response.body))


@functools.lru_cache(maxsize=2)  # as it is, and zipped
def _with_script(body: bytes, *, zipped: bool) -> bytes:
    page = gzip.decompress(body) if zipped else body
    script = f"<head><script>{fill_page_file('keep_hash.js')}</script>"
    page = page.replace(b"<head>", script.encode(), 1)
    return gzip.compress(page) if zipped else page
