import asyncio
from typing import Any

import pytest
import viser

from app.viewer.widgets.actions import on_option, on_press
from app.viewer.widgets.commands import CAMERA_KEYS, Command, Commands, help_html
from tests.support.page import FakePage
from tests.support.widgets import run_apart


def registered(server: viser.ViserServer) -> dict[str, Any]:
    """The commands that pages know, by label."""
    return {handle.label: handle for handle in server.gui._command_handle_from_uuid.values()}


def test_a_command_is_known_to_pages_with_its_key(server: viser.ViserServer) -> None:
    commands = Commands(server)
    commands.add("View", "Top view", lambda: None, key="T")
    commands.add("State", "Undo", lambda: None, key="Z", modifier="cmd/ctrl")
    handles = registered(server)
    assert handles["Top view"].hotkey == "T"
    assert handles["Undo"].modifier == "cmd/ctrl"
    assert handles["Show all keys and commands"].hotkey == "H"


def test_it_acts_for_the_page_that_asks(server: viser.ViserServer) -> None:
    asked: list[Any] = []
    commands = Commands(server)
    commands.add_for_page("View", "Top view", asked.append, key="T")
    page: Any = object()
    (callback,) = registered(server)["Top view"]._impl.trigger_cb
    event = viser.CommandEvent(client=page, client_id=1, target=registered(server)["Top view"])
    coroutine = callback(event)
    with pytest.raises(StopIteration):
        coroutine.send(None)
    assert asked == [page]


@pytest.mark.parametrize("key", sorted(CAMERA_KEYS))
def test_no_command_takes_a_key_that_flies_the_camera(server: viser.ViserServer, key: str) -> None:
    with pytest.raises(ValueError, match="flies the camera"):
        Commands(server).add("View", "Anything", lambda: None, key=key)


def test_no_key_has_two_commands(server: viser.ViserServer) -> None:
    commands = Commands(server)
    with pytest.raises(ValueError, match="H is taken by 'Show all keys"):
        commands.add("View", "Hide", lambda: None, key="H")
    commands.add("View", "Hide", lambda: None, key="H", modifier="shift")
    commands.add("View", "No key", lambda: None)
    commands.add("View", "None either", lambda: None)


def test_the_help_page_lists_every_command_and_escapes_it() -> None:
    html = help_html(
        (
            Command("View", "Top view", "T", None),
            Command("State", "Undo", "Z", "cmd/ctrl"),
            Command("State", "<b>bold</b>", None, None),
        )
    )
    assert "<kbd>T</kbd>" in html
    assert "<kbd>Ctrl/Cmd + Z</kbd>" in html
    assert "&lt;b&gt;bold" in html
    assert "Shift + click" in html


def test_every_button_is_a_command(server: viser.ViserServer) -> None:
    commands, pressed = Commands(server), list[str]()
    commands.add("Pair", "Known", lambda: pressed.append("command"))
    known = server.gui.add_button("Known")
    one = server.gui.add_button("One")
    group = server.gui.add_button_group("Step", ("next", "previous"))
    on_press(one, lambda: pressed.append("one"))
    on_press(known, lambda: pressed.append("known"))
    on_option(group, pressed.append)
    commands.add_buttons()
    labels = [command.label for command in commands.commands]
    assert labels[1:] == ["Known", "One", "Step: next", "Step: previous"]
    page = FakePage()

    async def run(label: str) -> None:
        handle = registered(server)[label]
        (act,) = handle._impl.trigger_cb
        await act(viser.CommandEvent(page, 1, handle))
        await asyncio.sleep(0)

    for label in ("One", "Step: previous", "Known"):
        run_apart(run(label))
    assert pressed == ["one", "previous", "command"]
    one.disabled = True
    run_apart(run("One"))
    assert pressed[3:] == []
    assert page.notes == ["Not possible now"]
    assert "Step: next" not in help_html(commands.commands)
