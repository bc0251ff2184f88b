"""What the viewer uses of viser beyond its public interface: each private name stands here, once.

``tests/app/viewer/server/test_viser.py`` fails when a release of viser changes what was read for
it; ``assets/guide/viser.md`` says what viser would need so that this is not needed.
"""

import asyncio
import contextlib
from collections.abc import AsyncGenerator, Callable, Sequence
from typing import Any

import viser
from viser import _messages as messages
from viser.infra._async_message_buffer import AsyncMessageBuffer


def state_of(handle: Any) -> Any:
    """Viser's state behind a widget: its uuid, value, callbacks, and where it lies."""
    return handle._impl


def group_of(handle: Any) -> Any:
    """The group of a tab; of anything else, itself."""
    return getattr(handle, "_parent", handle)


def inputs_of(host: Any) -> dict[str, Any]:
    """The widgets that a user can act on, by uuid; viser's kinds have no common class."""
    return host.gui._gui_input_handle_from_uuid


def containers_of(host: Any) -> dict[str, Any]:
    """The folders, tabs and the like of a server or of one page, by uuid."""
    return host.gui._container_handle_from_uuid


def send_to(page: viser.ClientHandle, message: messages.Message) -> None:
    """Send one page a message for which viser has no method."""
    page._websock_connection.queue_message(message)  # pyright: ignore[reportPrivateUsage]


def broadcast(server: Any, message: messages.Message) -> None:
    """Send all pages, and one that is recorded, a message for which viser has no method."""
    _sockets(server).queue_message(message)


def connections_of(server: Any) -> dict[int, Any]:
    """The open connections by viser's number of their page."""
    return _sockets(server)._live_connections


def spare_from_broadcasts(server: Any, is_spared: Callable[[int], bool]) -> None:
    """Send some pages what viser begins with, and nothing else of what all are sent."""
    broadcast = _sockets(server)._broadcast_buffer
    first = tuple(broadcast.message_from_id.values())
    all_windows = broadcast.window_generator

    def windows(page: int, backlog_done_message: messages.Message | None = None) -> Any:
        if is_spared(page):
            done = () if backlog_done_message is None else (backlog_done_message,)
            return _nothing_but((*first, *done))
        return all_windows(page, backlog_done_message)

    broadcast.window_generator = windows


async def _nothing_but(
    window: Sequence[messages.Message],
) -> AsyncGenerator[Sequence[messages.Message]]:
    """Send a page what it waits for as it begins, and then nothing as long as it is there."""
    yield window
    await asyncio.get_running_loop().create_future()


def _sockets(server: Any) -> Any:
    return server._websock_server


class _LoopEvent(asyncio.Event):
    """An event that only its loop sets; elsewhere, setting it does nothing.

    viser sets the event that wakes a page's sender from whatever thread has something to send, and
    then once more inside the loop. The first of these fails now and then, with "deque mutated
    during iteration", when many pages come and go.
    """

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        super().__init__()
        self._of = loop

    def set(self) -> None:
        with contextlib.suppress(RuntimeError):  # no loop runs in this thread
            if asyncio.get_running_loop() is self._of:
                super().set()


_buffers: Any = AsyncMessageBuffer
_init: Callable[..., None] = _buffers.__init__


def _init_with_loop_event(buffer: Any, *args: Any, **options: Any) -> None:
    _init(buffer, *args, **options)
    buffer.message_event = _LoopEvent(buffer.event_loop)


_buffers.__init__ = _init_with_loop_event
