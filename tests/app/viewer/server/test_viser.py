"""Access control leans on how one release of viser works: when that changes, somebody must look."""

import asyncio
import hashlib
import inspect
import re
import threading
from pathlib import Path
from typing import Any

import pytest
import viser
import websockets.asyncio.server
from viser import _messages
from viser._gui_api import GuiApi
from viser.infra import _async_message_buffer, _infra
from viser.infra import _messages as infra_messages

from app.viewer.server import guard
from app.viewer.server.guard import open_server
from tests.support.widgets import run_apart

# Source that was read for it, and its digest then. If one differs, read what changed,
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


def test_nothing_is_served_without_access_control(monkeypatch: pytest.MonkeyPatch) -> None:
    """A viser that calls another function than the one that is wrapped is not trusted."""
    monkeypatch.setattr(guard.AccessControl, "serve", lambda _, serve, *a, **k: serve(*a, **k))
    with pytest.raises(RuntimeError, match="cannot be guarded"):
        open_server("127.0.0.1", 0)


def test_websockets_is_left_as_it_was() -> None:
    before = websockets.asyncio.server.serve
    server, access = open_server("127.0.0.1", 0)
    assert websockets.asyncio.server.serve is before
    assert access.is_open
    server.stop()


def test_private_names_of_viser_stand_in_one_module() -> None:
    private = re.compile(r"\b_(impl|websock\w+|\w+_from_uuid)\b|viser(\._(?!_)|\.infra| import _)")
    root = Path(__file__).resolve().parents[4] / "app"
    users = [p.name for p in root.rglob("*.py") if private.search(p.read_text("utf-8"))]
    assert users == ["internals.py"]


def test_a_message_of_any_thread_wakes_who_waits_in_the_loop() -> None:
    async def wait() -> None:
        loop = asyncio.get_running_loop()
        buffer = _async_message_buffer.AsyncMessageBuffer(loop, persistent_messages=False)
        waiting = asyncio.create_task(buffer.message_event.wait())
        await asyncio.sleep(0)
        thread = threading.Thread(target=buffer.push, args=[_messages.ResetGuiMessage()])
        thread.start()
        thread.join()
        assert not buffer.message_event.is_set()  # that is left to the loop
        await asyncio.wait_for(waiting, 60)
        assert buffer.message_event.is_set()

    run_apart(wait())
