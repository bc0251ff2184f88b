"""The door leans on how one release of viser works: when that changes, somebody must look."""

import hashlib
import inspect
from typing import Any

import pytest
import viser
import websockets.asyncio.server
from viser._gui_api import GuiApi
from viser.infra import _async_message_buffer, _infra
from viser.infra import _messages as infra_messages

from app.viewer.server import guard as door_module
from app.viewer.server.guard import open_server

# Source that was read for the door, and its digest then. If one differs, read what changed,
# see whether `server.guard` still stands before everything that a page can say, and write the new
# digest here.
READ: dict[str, tuple[Any, str]] = {
    "the server": (_infra.WebsockServer._background_worker, "59b19aac01fb31a3"),
    "what is read": (_infra._message_consumer, "ef071771f1a2bda2"),
    "how it is read": (infra_messages.Message.deserialize, "aae3671624edbf96"),
    "whom it reaches": (_infra.WebsockMessageHandler._handle_incoming_message, "10ad01e6008ea965"),
    "widgets": (GuiApi._handle_gui_updates, "98bff2504661cbbb"),
    "a new page": (viser.ViserServer.__init__, "14c27c9c9808abeb"),
    "what wakes": (_async_message_buffer.AsyncMessageBuffer.push, "09b5346a7a6c5520"),
}


def digest(part: Any) -> str:
    return hashlib.sha256(inspect.getsource(part).encode()).hexdigest()[:16]


@pytest.mark.parametrize("name", READ)
def test_viser_is_as_it_was_read(name: str) -> None:
    part, expected = READ[name]
    assert digest(part) == expected, f"viser {viser.__version__}: {part.__qualname__} has changed"


def test_nothing_is_served_without_the_door(monkeypatch: pytest.MonkeyPatch) -> None:
    """A viser that calls another function than the one that is wrapped is not trusted."""
    monkeypatch.setattr(
        door_module.AccessControl, "serve", lambda _, serve, *a, **k: serve(*a, **k)
    )
    with pytest.raises(RuntimeError, match="cannot be guarded"):
        open_server("127.0.0.1", 0)


def test_websockets_is_left_as_it_was() -> None:
    before = websockets.asyncio.server.serve
    server, door = open_server("127.0.0.1", 0)
    assert websockets.asyncio.server.serve is before
    assert door.is_open
    server.stop()
