"""Numbers that a person types, and sliders that a pointer or a key moves.

viser's number boxes leave out what they take for no part of a number while it is typed: "0,8"
becomes 8, and "1e9" 19. So a script of ours keeps the boxes to itself while a person types, and
says the whole text once it is complete: with Enter, or when the box is left. What it means is
decided here. The script also says where a slider was let go: until then, it is on its way.

viser's sliders are linear. The script puts thumbs and marks on a scale where equal ways are equal
factors, because one millimetre matters at 5 mm and not at 50 cm. It turns what a hand or a key does
there into a number in the box beside the slider, as if it had been typed. And it puts a chip onto
the box, a word that says where the value comes from, and a strip below the slider, which says at
which values a pair is a loop closure.
"""

import json
import re
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from typing import Any

import viser
from msgspec import Struct

from app.viewer.server.host import Host
from app.viewer.web import fill_page_file
from app.viewer.widgets.bridge import Bridge, inline_script, page_script
from app.viewer.widgets.html import uuid_of
from gpgrad_core.errors import InputError
from gpgrad_core.params import DIGITS, Bounds

NUMBER = re.compile(r"[+-]?(\d+[.,]?\d*|[.,]\d+)(e[+-]?\d+)?", re.ASCII | re.IGNORECASE)
GROUPS = re.compile(r"[+-]?[1-9]\d{0,2},\d{3}", re.ASCII)
"""One comma that may part thousands as well as decimals."""
LENGTHS = {"mm": 0.001, "cm": 0.01, "m": 1.0, "km": 1000.0}
WITH_UNIT = re.compile(r"(.*[\d.,])\s*([a-z°]+)", re.IGNORECASE)
LONGEST = 40
"""Characters of such a number; what is longer is none."""
REST_MS = 60
"""A page says where something was let go after its last value, which viser may keep for 50 ms."""
MOST_MOVES = 50
"""That a page says at once: of more presses without a pause, the last ones."""


class Typed(Struct):
    """What was typed into the box of a widget."""

    widget: str
    text: str


class Rested(Struct):
    """Where widgets were let go: of each its name and its value, joined by ``;``."""

    moves: str


class Pressed(Struct):
    """The widget whose chip was pressed."""

    widget: str


@dataclass(frozen=True)
class Chip:
    """What a chip says."""

    word: str  # one short word
    hint: str  # shown where the pointer rests on it
    back: bool = False  # whether it can be pressed, to go back


@dataclass(frozen=True)
class Strip:
    """What holds at the values of a slider."""

    edges: tuple[float, ...]  # values between which the same holds, ascending
    # whether the pair is a loop closure, of each stretch between two edges
    accepted: tuple[bool, ...]
    hint: str  # the same in words, and the result at each value
    stale: bool = False  # whether it was so before the last change, and is being computed anew


@dataclass(frozen=True)
class _Box:
    handle: viser.GuiInputHandle[Any]
    take: Callable[[str], None]
    go_back: Callable[[], None]


class Numbers:
    """Receives what is typed into the number boxes of a session, and where sliders are released."""

    def __init__(self, host: Host, bridge: Bridge) -> None:
        # called with why a number was refused
        self.refuse: Callable[[str], None] = lambda why: None  # noqa: ARG005
        # called with the name of a widget, and its value on release; None for the last that it has
        # sent
        self.rested: Callable[[str, float | None], None] = lambda widget, value: None  # noqa: ARG005
        self.chips: Mapping[str, Chip] = {}  # by the name of their slider
        self.strips: Mapping[str, Strip] = {}  # likewise
        self._bridge = bridge
        self._boxes: dict[str, _Box] = {}
        self._decades: dict[str, bool] = {}  # sliders over decades: whether their numbers are whole
        script = page_script("numbers.js", REST_MS=REST_MS, MOST_MOVES=MOST_MOVES, DIGITS=DIGITS)
        style = f"<style>{fill_page_file('numbers.css')}</style>"
        host.gui.add_html(style + script)
        self._sent = host.gui.add_html("")
        bridge.on_message("typed", Typed, self._hear_typed)
        bridge.on_message("rested", Rested, self._hear_rested)
        bridge.on_message("way-back", Pressed, self._hear_pressed)

    def add(
        self,
        handle: viser.GuiInputHandle[Any],
        bounds: Bounds | None,
        act: Callable[[float], None],
        go_back: Callable[[], None] = lambda: None,
    ) -> None:
        """Call a function with each number that is typed into a box; it shows the result.

        The box is a number's, or that beside a slider, which spans decades where the bounds do.
        An `InputError` is reported. ``go_back`` is called when the slider's chip is pressed.
        """
        name, _, _ = str(handle.label).partition(" [")
        whole = isinstance(handle.value, int)
        self._boxes[uuid_of(handle)] = _Box(
            handle, lambda text: act(read_number(text, name, bounds, whole=whole)), go_back
        )
        is_slider = isinstance(handle, viser.GuiSliderHandle)
        if is_slider and bounds is not None and bounds.spans_decades:
            self._decades[uuid_of(handle)] = whole
            self._tell()

    def show_chips(self, chips: Mapping[str, Chip]) -> None:
        self.chips = chips
        self._tell()

    def show_strips(self, strips: Mapping[str, Strip]) -> None:
        self.strips = strips
        self._tell()

    def _tell(self) -> None:
        """Send the sliders to the script; nothing is sent if it has all of it."""
        chips, strips = (
            {widget: asdict(shown) for widget, shown in each.items()}
            for each in (self.chips, self.strips)
        )
        told = json.dumps({"decades": self._decades, "chips": chips, "strips": strips})
        self._sent.content = inline_script(f"window.gpgradSliders={told};window.gpgradNumbers?.()")

    def _hear_pressed(self, page: viser.ClientHandle, pressed: Pressed) -> None:
        del page
        chip = self.chips.get(pressed.widget)
        if chip is not None and chip.back:
            self._boxes[pressed.widget].go_back()

    def _hear_typed(self, page: viser.ClientHandle, typed: Typed) -> None:
        box = self._boxes.get(typed.widget)
        if box is None:
            return
        handle = box.handle
        before, refused = handle.value, ""
        try:
            if handle.visible and not handle.disabled:
                box.take(typed.text)
        except InputError as error:
            refused = str(error)
            self.refuse(refused)
        # A number that is the same as before is sent to no page: this one writes it anew.
        changed = handle.value != before
        answer = {"widget": typed.widget, "changed": changed, "refused": refused}
        self._bridge.call(page, "typed", answer)

    def _hear_rested(self, page: viser.ClientHandle, rested: Rested) -> None:
        del page
        for move in rested.moves.split(";")[:MOST_MOVES]:
            widget, _, value = move.partition(" ")
            try:
                self.rested(widget, float(value) if value else None)
            except (ValueError, OverflowError):
                return  # no page of ours says so


def read_number(text: str, name: str, bounds: Bounds | None = None, *, whole: bool) -> float:
    """Read what a person typed; a decimal comma is a point, and lengths may have another unit.

    >>> read_number("0,8", "Noise", whole=False), read_number("1e3", "Points", whole=True)
    (0.8, 1000)
    >>> read_number("80 cm", "Radius", Bounds(0.0, 10.0, 0.1, "m"), whole=False)
    0.8

    An InputError by that name refuses what is no number, is out of bounds, or has two readings.
    """
    typed = text.strip().replace("\N{MINUS SIGN}", "-")
    shown = typed
    said = repr(typed if len(typed) <= LONGEST else typed[:LONGEST] + "…") if typed else "nothing"
    typed, factor = _without_unit(typed, "" if bounds is None else bounds.unit)
    if len(typed) > LONGEST or not NUMBER.fullmatch(typed):
        raise InputError(f"{name} must be a number such as {'20' if whole else '0.8'}, got {said}")
    if GROUPS.fullmatch(typed) or (whole and "," in typed):
        plain, point = typed.replace(",", ""), typed.replace(",", ".")
        raise InputError(f"{name}: {said} can be read in two ways; write {plain} or {point}")
    number = float(typed.replace(",", "."))
    number = number if factor == 1.0 else float(f"{number * factor:.12g}")
    if bounds is not None and not bounds.holds(number):
        raise InputError(f"{name} must be from {bounds.range}, got {shown}")
    if not whole:
        return number
    if not number.is_integer():
        raise InputError(f"{name} must be a whole number, got {typed}")
    return round(number)


def _without_unit(typed: str, unit: str) -> tuple[str, float]:
    """Part a number from the unit behind it, and give how many of the box's own unit that is."""
    match = WITH_UNIT.fullmatch(typed)
    if match is None or not unit:
        return typed, 1.0
    if match[2] == unit:
        return match[1], 1.0
    if unit in LENGTHS and match[2].lower() in LENGTHS:
        return match[1], LENGTHS[match[2].lower()] / LENGTHS[unit]
    return typed, 1.0
