"""What a widget does when a user acts on it; what the program itself sets calls nothing.

All handlers are asynchronous, so that the server runs them in order in its event loop; plain
functions would go to a pool of threads and could overtake each other. So they must be quick. Files
are the exception: to take one in may take a while, and happens in a thread.
"""

import asyncio
from collections.abc import Callable, Coroutine, Iterable
from typing import Any, TypeAlias, TypeVar

import viser

Option = TypeVar("Option", bound=str)
Handler: TypeAlias = Callable[[viser.GuiEvent[Any]], Coroutine[Any, Any, None]]


def _by_user(act: Callable[[Any], None]) -> Handler:
    async def handle(event: viser.GuiEvent[Any]) -> None:
        if event.client_id is not None:
            act(event.target.value)

    return handle


def _by_page(act: Callable[[viser.ClientHandle, Any], None]) -> Handler:
    async def handle(event: viser.GuiEvent[Any]) -> None:
        if event.client is not None:
            act(event.client, event.target.value)

    return handle


def on_press(button: viser.GuiButtonHandle, act: Callable[[], None]) -> None:
    """Call something when a button is pressed."""
    button.on_click(_by_user(lambda _: act()))


def on_press_by(button: viser.GuiButtonHandle, act: Callable[[viser.ClientHandle], None]) -> None:
    """Call something with the page on which a button is pressed."""
    button.on_click(_by_page(lambda page, _: act(page)))


def on_choice(handle: viser.GuiInputHandle[Any], act: Callable[[Any], None]) -> None:
    """Call something with the new value when a user changes an input."""
    handle.on_update(_by_user(act))


def on_choice_by(
    handle: viser.GuiInputHandle[Any], act: Callable[[viser.ClientHandle, Any], None]
) -> None:
    """Call something with the page on which a user changes an input, and the new value."""
    handle.on_update(_by_page(act))


def on_option(buttons: viser.GuiButtonGroupHandle, act: Callable[[str], None]) -> None:
    """Call something with the label of the button of a group that is pressed."""
    buttons.on_click(_by_user(act))


def on_option_by(
    buttons: viser.GuiButtonGroupHandle, act: Callable[[viser.ClientHandle, str], None]
) -> None:
    """Call something with the page on which a button of a group is pressed, and its label."""
    buttons.on_click(_by_page(act))


def one_of(options: Iterable[Option], label: str) -> Option:
    """The option that a label names."""
    return next(option for option in options if option == label)


def on_step(buttons: viser.GuiButtonGroupHandle, act: Callable[[int], None]) -> None:
    """Call something with 1 when "next" of a group is pressed, and else with -1."""
    on_option(buttons, lambda label: act(1 if label == "next" else -1))


def on_upload(button: viser.GuiUploadButtonHandle, act: Callable[[str, bytes], None]) -> None:
    """Call something with the name and the content of a file that a page uploads."""

    @button.on_upload
    async def _(event: viser.GuiEvent[viser.GuiUploadButtonHandle]) -> None:
        file = event.target.value
        await asyncio.to_thread(act, file.name, file.content)
