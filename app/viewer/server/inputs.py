"""What a page says is checked here before viser acts on it: kind, bounds, options, length.

viser sets whatever property a message names to whatever it brings, and tells all other pages. A
number beyond 64 bits among that cannot be sent, and would end every connection, those to come
included. So a message gets no further unless it is one that the viewer's own page could send.
"""

import dataclasses
import math
import re
from collections.abc import Mapping
from typing import Annotated, Any, Literal, TypeAlias, cast, get_type_hints

import msgspec
import viser

from app.viewer.server.internals import messages
from gpgrad_core.params import Bounds, number_text

LARGEST_NUMBER = 2**53
"""Beyond it, whole numbers are not exact in a browser."""
LONGEST_TEXT = 4096
"""Characters in a text box; a path may have as many."""
LARGEST_PICTURE = 40_000_000
"""Pixels of a picture of the page: more than a screen of 8K has."""
CONTROL = re.compile(r"[\x00-\x1f\x7f]")
"""Characters that no name and no line of text has."""

Number: TypeAlias = Annotated[float, msgspec.Meta(ge=-LARGEST_NUMBER, le=LARGEST_NUMBER)]
Name: TypeAlias = Annotated[str, msgspec.Meta(max_length=1000)]
Ray: TypeAlias = tuple[Number, Number, Number]

SPOKEN = (
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
"""All that the viewer's page says. What else viser would act on is not for pages to ask: above all
``ShareUrlRequest``, which opens the viewer to the internet."""
CLICKED: Mapping[str, Any] = {
    "event_type": Literal["click"],
    "ray_origin": Ray,
    "ray_direction": Ray,
    "screen_pos": tuple[tuple[Number, Number]],
}
"""Fields of a click into the scene. viser's class also stands for a rectangle that is drawn, which
has no ray; the viewer asks for none."""


def _bounded(kind: type[messages.Message]) -> type[msgspec.Struct]:
    """Make a class that has the fields of one of viser's messages, with bounds on each."""
    hints = get_type_hints(
        kind, localns={"int": Number, "float": Number, "str": Name}, include_extras=True
    )
    if kind is messages.ScenePointerMessage:
        hints |= CLICKED
    fields = [
        (field.name, hints[field.name])
        if field.default is dataclasses.MISSING
        else (field.name, hints[field.name], field.default)
        for field in dataclasses.fields(cast("Any", kind))
    ]
    return msgspec.defstruct(kind.__name__, fields, tag=True, forbid_unknown_fields=True)


_KINDS = {kind.__name__: _bounded(kind) for kind in SPOKEN}


class RefusedValue(Exception):
    """A value that a widget cannot have; the text is for people: the rule, and the value."""


def read_message(frame: object) -> dict[str, Any] | None:
    """Decode a frame; None for what is no message with the fields of viser's class of its name."""
    try:
        message = msgspec.msgpack.decode(cast("bytes", frame))
        msgspec.convert(message, _KINDS[message["type"]], builtin_types=(bytes,))
    except (msgspec.MsgspecError, LookupError, TypeError, ValueError, RecursionError):
        return None
    return message


def is_small_enough(picture: bytes) -> bool:
    """Whether a picture of a page, a PNG, unpacks to what a screen may have."""
    if not picture:
        return True  # how a page says that it has none
    if len(picture) < 24 or picture[:8] != b"\x89PNG\r\n\x1a\n":
        return False
    width, height = (int.from_bytes(picture[at : at + 4], "big") for at in (16, 20))
    return 0 < width * height <= LARGEST_PICTURE


def checked_value(widget: Any, updates: Mapping[str, object]) -> Any:
    """The value that a page may set a widget to; else it is a RefusedValue.

    The end of a slider is what a page means by a value that lies a hair beyond. It is what the core
    checks: the slider's ends come from the bounds of its parameter.
    """
    if list(updates) != ["value"]:
        raise RefusedValue("only its value can be changed")
    value: Any = updates["value"]
    kind: type[Any] = type(widget)
    if issubclass(kind, viser.GuiSliderHandle | viser.GuiNumberHandle):
        return _checked_number(widget, value)
    if issubclass(kind, viser.GuiCheckboxHandle | viser.GuiButtonHandle):
        rule = None if isinstance(value, bool) else f"must be on or off, got {shown(value)}"
    elif issubclass(kind, viser.GuiDropdownHandle | viser.GuiButtonGroupHandle):
        offers = value in widget.options
        rule = None if offers else f"offers no such choice as {shown(value)}"
    elif issubclass(kind, viser.GuiTextHandle):
        rule = _broken_rule_of_text(value)
    else:
        rule = "cannot be changed"
    if rule is not None:
        raise RefusedValue(rule)
    return value


def shown(value: object) -> str:
    """Write a value in a message, in few words whatever it is."""
    if isinstance(value, int) and abs(value) > LARGEST_NUMBER:
        return "a number beyond all bounds"
    text = number_text(value) if isinstance(value, float) else repr(value)
    return text if len(text) <= 40 else f"{text[:37]}..."


def _broken_rule_of_text(value: object) -> str | None:
    if not isinstance(value, str):
        return f"must be a text, got {shown(value)}"
    if len(value) > LONGEST_TEXT:
        return f"may have {LONGEST_TEXT:,} characters, got {len(value):,}"
    if CONTROL.search(value):
        return "must be a text of one line, without control characters"
    return None


def _checked_number(widget: Any, value: object) -> float:
    if not isinstance(value, int | float) or isinstance(value, bool) or math.isnan(value):
        raise RefusedValue(f"must be a number, got {shown(value)}")
    low, high = widget.min, widget.max
    bounds = Bounds(
        -LARGEST_NUMBER if low is None else low, LARGEST_NUMBER if high is None else high, 1
    )
    if isinstance(widget, viser.GuiSliderHandle):
        value = bounds.nearest(value)
    if not bounds.holds(value):
        rule = f"from {bounds.range}"
        if low is None or high is None:
            above = value > bounds.high
            rule = f"at most {bounds.high:.10g}" if above else f"at least {bounds.low:.10g}"
        raise RefusedValue(f"must be {rule}, got {shown(value)}")
    if isinstance(widget.value, int) and value != round(value):
        raise RefusedValue(f"must be a whole number, got {shown(value)}")
    return value
