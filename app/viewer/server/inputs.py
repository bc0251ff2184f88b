"""What a page says is checked here before viser acts on it: kind, bounds, options, length.

viser sets whatever property a message names to whatever it brings, and tells all other pages. A
number beyond 64 bits among that cannot be sent, and would end every connection, those to come
included. So a message gets no further unless it is one that the viewer's own page could send.
"""

import dataclasses
import math
import re
import types
from collections.abc import Mapping
from functools import cache
from typing import Any, Literal, Union, cast, get_args, get_origin, get_type_hints

import msgspec
import viser
from viser import _messages as messages

from gpgrad_core.params import Bounds, number_text

LONGEST_NAME = 1000
"""Characters of what names a thing: a widget, a node, a file."""
LONGEST_TEXT = 4096
"""Characters in a text box; a path may have as many."""
LARGEST_NUMBER = 2**53
"""Beyond it, whole numbers are not exact in a browser."""
LARGEST_PICTURE = 40_000_000
"""Pixels of a picture of the page: more than a screen of 8K has."""
CONTROL = re.compile(r"[\x00-\x1f\x7f]")
"""Characters that no name and no line of text has."""

SPOKEN: Mapping[str, type[messages.Message]] = {
    kind.__name__: kind
    for kind in (
        messages.GuiUpdateMessage,
        messages.CommandTriggerMessage,
        messages.ViewerCameraMessage,
        messages.SceneNodeClickMessage,
        messages.SceneNodeDragMessage,
        messages.ScenePointerMessage,
        messages.TransformControlsUpdateMessage,
        messages.TransformControlsDragStartMessage,
        messages.TransformControlsDragEndMessage,
        messages.GetRenderResponseMessage,
        messages.FileTransferStartUpload,
        messages.FileTransferPart,
    )
}
"""All that the viewer's page says. What else viser would act on is not for pages to ask: above all
``ShareUrlRequest``, which opens the viewer to the internet."""
CLICKED: Mapping[str, Any] = {
    "event_type": Literal["click"],
    "ray_origin": tuple[float, float, float],
    "ray_direction": tuple[float, float, float],
    "screen_pos": tuple[tuple[float, float]],
}
"""Fields of a click into the scene. viser's class also stands for a rectangle that is drawn, which
has no ray; the viewer asks for none."""


class Malformed(Exception):
    """A frame that no page sends."""


def read_message(frame: object) -> dict[str, Any] | None:
    """Take a frame apart.

    Returns:
        The message, whose fields are what viser's class of that name says; None for one that is
        not to be acted on.

    Raises:
        Malformed: If the frame is no message at all.
    """
    if not isinstance(frame, bytes):
        raise Malformed("text")
    try:
        decoded: object = msgspec.msgpack.decode(frame)
    except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError, ValueError) as error:
        raise Malformed("not MessagePack") from error
    if not isinstance(decoded, dict) or not isinstance(decoded.get("type"), str):
        raise Malformed("no message")
    message = cast("dict[str, Any]", decoded)
    kind = SPOKEN.get(message["type"])
    if kind is None:
        return None
    hints, needed = _fields(kind)
    given = message.keys() - {"type"}
    if not (needed <= given <= hints.keys()):
        return None
    return message if all(fits(message[name], hints[name]) for name in given) else None


def fits(value: object, hint: Any) -> bool:  # noqa: PLR0911 - a case for each kind
    """Say whether a value is what an annotation of viser's messages says, and of a sane size.

    >>> fits(3, float), fits(float("nan"), float), fits([1, 2], tuple[float, float])
    (True, False, True)
    """
    origin, inner = get_origin(hint), get_args(hint)
    if hint in (int, float):
        return _is_number(value)
    if hint is str:
        return isinstance(value, str) and len(value) <= LONGEST_NAME
    if hint is bytes or origin is dict:
        return isinstance(value, bytes if hint is bytes else dict)
    if hint is type(None):
        return value is None
    if origin is Literal:
        return isinstance(value, str) and value in inner
    if origin in (Union, types.UnionType):
        return any(fits(value, kind) for kind in inner)
    if origin is tuple and isinstance(value, list):
        items = cast("list[object]", value)
        if inner[-1] is ...:
            return len(items) <= 16 and all(fits(item, inner[0]) for item in items)
        return len(items) == len(inner) and all(map(fits, items, inner))
    return False


def is_small_enough(picture: bytes) -> bool:
    """Say whether a picture of a page, a PNG, unpacks to what a screen may have."""
    if not picture:
        return True  # how a page says that it has none
    if len(picture) < 24 or picture[:8] != b"\x89PNG\r\n\x1a\n":
        return False
    width, height = (int.from_bytes(picture[at : at + 4], "big") for at in (16, 20))
    return 0 < width * height <= LARGEST_PICTURE


def why_not(widget: Any, updates: Mapping[str, object]) -> str | None:
    """Say why a widget cannot be changed so.

    Args:
        widget: That a page wants to change; viser's kinds have no common class.
        updates: Values by property, as the page gave them.

    Returns:
        The rule that is broken and the value, for people; None if it can.
    """
    if len(updates) != 1 or "value" not in updates:
        return "only its value can be changed"
    value = updates["value"]
    if isinstance(widget, viser.GuiCheckboxHandle | viser.GuiButtonHandle):
        return None if isinstance(value, bool) else f"must be on or off, got {shown(value)}"
    if isinstance(widget, viser.GuiDropdownHandle | viser.GuiButtonGroupHandle):
        options = cast("Any", widget).options
        return None if value in options else f"offers no such choice as {shown(value)}"
    if isinstance(widget, viser.GuiTextHandle):
        return _why_no_text(value)
    if isinstance(widget, viser.GuiSliderHandle | viser.GuiNumberHandle):
        number = cast("Any", widget)
        whole = isinstance(number.value, int)
        meant = as_meant(widget, value)
        return _why_no_number(meant, number.min, number.max, whole=whole)
    return "cannot be changed"


def as_meant(widget: Any, value: Any) -> Any:
    """Give what a page means by a value: the end of a slider, if it lies a hair beyond.

    It is what the core checks: the slider's ends come from the bounds of its parameter.
    """
    if isinstance(widget, viser.GuiSliderHandle) and isinstance(value, int | float):
        slider = cast("Any", widget)
        return _bounds(slider.min, slider.max).nearest(value)
    return value


def shown(value: object) -> str:
    """Write a value in a message, in few words whatever it is."""
    if isinstance(value, int) and abs(value) > LARGEST_NUMBER:
        return "a number beyond all bounds"
    text = number_text(value) if isinstance(value, float) else repr(value)
    return text if len(text) <= 40 else f"{text[:37]}..."


def _why_no_text(value: object) -> str | None:
    if not isinstance(value, str):
        return f"must be a text, got {shown(value)}"
    if len(value) > LONGEST_TEXT:
        return f"may have {LONGEST_TEXT:,} characters, got {len(value):,}"
    if CONTROL.search(value):
        return "must be a text of one line, without control characters"
    return None


def _why_no_number(
    value: object, low: float | None, high: float | None, *, whole: bool
) -> str | None:
    if not isinstance(value, int | float) or isinstance(value, bool) or math.isnan(value):
        return f"must be a number, got {shown(value)}"
    bounds = _bounds(low, high)
    if not bounds.holds(value):
        rule = f"from {bounds.range}"
        if low is None or high is None:
            above = value > bounds.high
            rule = f"at most {bounds.high:.10g}" if above else f"at least {bounds.low:.10g}"
        return f"must be {rule}, got {shown(value)}"
    if whole and value != round(value):
        return f"must be a whole number, got {shown(value)}"
    return None


def _bounds(low: float | None, high: float | None) -> Bounds:
    return Bounds(
        -LARGEST_NUMBER if low is None else low, LARGEST_NUMBER if high is None else high, 1
    )


def _is_number(value: object) -> bool:
    return (
        isinstance(value, int | float)
        and not isinstance(value, bool)
        and math.isfinite(value)
        and abs(value) <= LARGEST_NUMBER
    )


@cache
def _fields(kind: type[messages.Message]) -> tuple[dict[str, Any], frozenset[str]]:
    """Give the annotations of a message's fields by name, and the names that must be there."""
    hints, missing = get_type_hints(kind), dataclasses.MISSING
    if kind is messages.ScenePointerMessage:
        hints |= CLICKED
    fields = dataclasses.fields(cast("Any", kind))
    needed = frozenset(
        field.name
        for field in fields
        if field.default is missing and field.default_factory is missing
    )
    return {field.name: hints[field.name] for field in fields}, needed
