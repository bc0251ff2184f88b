"""A params dataclass -> sliders: bounds, unit, tooltip and default all come from its fields."""

import math
from collections.abc import Callable, Collection, Mapping
from typing import Any, Generic, TypeVar

import viser

from app.viewer.server.host import Host
from app.viewer.widgets.actions import on_choice, on_press
from app.viewer.widgets.chips import Chip, Chips
from app.viewer.widgets.html import uuid_of
from app.viewer.widgets.numbers import Numbers, spread_over_decades
from app.viewer.widgets.options import add_input, is_slider
from gpgrad_core.errors import InputError
from gpgrad_core.params import DIGITS, Bounds, Field, get_path, parameters_of, with_path, with_unit

P = TypeVar("P")


class ParamsPanel(Generic[P]):
    """A widget for each parameter of a params object; reports the whole new value.

    The main ones stand where the panel is made; the others lie below in a folded folder, a
    group a stage. Callbacks run in the server's event loop: ``on_change`` must only hand the
    value on.
    """

    def __init__(
        self,
        host: Host,
        value: P,
        on_change: Callable[[P], None],
        *,
        main: Mapping[str, str],
        on_error: Callable[[str], None] | None = None,
        on_move: Callable[[P], None] | None = None,
        numbers: Numbers | None = None,
        used: P | None = None,
        boxes: Mapping[str, str] | None = None,
        chips: Chips | None = None,
        below: Callable[[], None] = lambda: None,
        drawer: Callable[[], None] = lambda: None,
    ) -> None:
        """Make the widgets in the current container.

        Args:
            host: Whose GUI they join.
            value: What they start at, and what "default" means until `set_default`.
            on_change: Given the whole new value after each change by a user.
            main: Paths of the parameters that stand outside the folder, in this order, and
                their names for people (the unit is added).
            on_error: Given the message if a value is refused.
            on_move: Given the value in place of ``on_change`` while a hand is on a slider; None
                makes no difference.
            numbers: Takes what is typed beside the sliders.
            used: The same with numbers for what is automatic; the sliders show these.
            boxes: Labels of the boxes for "automatic" that stand above their slider, outside the
                folder; by the paths of main ones.
            chips: Say of each slider whether its value is automatic, a default or set by a person,
                and lead back from the last.
            below: Makes what stands below the main ones.
            drawer: Makes what stands first in the folder.
        """
        self._chips = chips
        self._main = main
        self._boxes = boxes or {}
        self._hidden: frozenset[str] = frozenset()
        self._on_move = on_move or on_change
        self._numbers = numbers
        self._host = host
        self._used = value if used is None else used
        self._default = value
        self._value = value
        self._on_change = on_change
        self._on_error = on_error
        self._inputs: dict[str, viser.GuiInputHandle[Any]] = {}
        self._automatic: dict[str, viser.GuiInputHandle[bool]] = {}
        self._decades: list[viser.GuiSliderHandle[Any]] = []
        self._settings = {setting.path: setting for setting in parameters_of(type(value))}
        for path, name in main.items():
            self._add(self._settings[path], name)
        below()
        with host.gui.add_folder("More", expand_by_default=False):
            drawer()
            self._add_groups(main)
            spread_over_decades(host, self._decades)
        if chips is not None:
            chips.pressed = self._go_back
        self._mark()

    @property
    def value(self) -> P:
        """The params as the widgets show them."""
        return self._value

    @property
    def used(self) -> P:
        """The same with numbers for what is automatic, as far as they are known."""
        return self._used

    def set(self, value: P, used: P | None = None) -> None:
        """Show other params, with numbers for what is automatic; ``on_change`` is not called."""
        only_numbers, self._value = value == self._value, value
        self._used = value if used is None else used
        for path, setting in self._settings.items():
            asked, number = get_path(value, path), get_path(self._used, path)
            if not only_numbers or asked != number:  # else it may be under a hand
                self._show(setting, number, automatic=asked is None)
        self._mark()

    def reset(self) -> P:
        """Go back to the defaults; returns them, ``on_change`` is not called."""
        self.set(self._default)
        return self._default

    def set_default(self, value: P) -> None:
        """Say what `reset` goes back to."""
        self._default = value
        self._mark()

    def hide(self, paths: Collection[str]) -> None:
        """Hide the widgets of parameters that do nothing now; all others are there again."""
        self._hidden = frozenset(paths)
        for path, setting in self._settings.items():
            automatic = get_path(self._value, path) is None
            self._show(setting, get_path(self._used, path), automatic=automatic)

    def name_automatic(self, labels: Mapping[str, str]) -> None:
        """Name boxes for "automatic" otherwise, by their paths; all others as usual."""
        for path, box in self._automatic.items():
            setting = self._settings[path]
            box.label = labels.get(path) or self._boxes.get(path) or self._automatic_label(setting)

    def _mark(self) -> None:
        """Say by chips where the values of the sliders come from."""
        if self._chips is None:
            return
        chips: dict[str, Chip] = {}
        for path in self._settings:
            handle, value = self._inputs[path], get_path(self._value, path)
            default, used = get_path(self._default, path), get_path(self._used, path)
            if not isinstance(handle, viser.GuiSliderHandle):
                continue
            # With the noise, its growth is chosen too, though it has a number when it is not.
            chosen = value is None or (value == default and used != value)
            if chosen:
                chip = Chip("auto", "Automatic: chosen for this dataset by its points.")
            elif value == default:
                chip = Chip("default", "As the dataset was opened.")
            else:
                to = "automatic" if default is None else f"the default, {default:g}"
                chip = Chip("set ↺", f"Set by hand. Press to go back to {to}.", back=True)
            chips[uuid_of(handle)] = chip
        self._chips.show(chips)

    def _go_back(self, widget: str) -> None:
        """Make the parameter of a slider what it was when the dataset was opened."""
        for path, handle in self._inputs.items():
            if uuid_of(handle) == widget:
                default = get_path(self._default, path)
                used = self._used if default is None else with_path(self._used, path, default)
                self.set(with_path(self._value, path, default), used)
                self._on_change(self._value)

    def _automatic_label(self, setting: Field) -> str:
        """Name the box of a parameter that may be automatic."""
        name = self._main.get(setting.path, setting.label.partition(" [")[0])
        return f"automatic {name.lower().removesuffix(' std')}"

    def _add_groups(self, main: Collection[str]) -> None:
        """Add a folder for each group; of what stands above, it has the box "automatic" only."""
        groups: dict[str, list[Field]] = {}
        for path, setting in self._settings.items():
            if path not in main or (setting.optional and path not in self._boxes):
                groups.setdefault(path.partition(".")[0], []).append(setting)
        for group, members in groups.items():
            title = group.replace("_", " ").capitalize()
            others = [setting for setting in members if setting.path not in main]
            with self._host.gui.add_folder(title):
                for setting in members:
                    if setting in others:
                        self._add(setting, None)
                    else:
                        self._add_automatic(setting)
                self._add_defaults(title, others)

    def _add_defaults(self, title: str, members: list[Field]) -> None:
        button = self._host.gui.add_button(
            f"{title} defaults",
            hint="Resets the parameters of this folder to their defaults (the marks).",
        )

        def reset() -> None:
            value = self._value
            for setting in members:
                value = with_path(value, setting.path, get_path(self._default, setting.path))
            self.set(value)
            self._on_change(value)

        on_press(button, reset)

    def _add(self, setting: Field, name: str | None) -> None:
        path = setting.path
        label = with_unit(name, setting.bounds) if name else setting.label
        current: Any = get_path(self._used, path)
        handle: viser.GuiInputHandle[Any]
        if is_slider(setting.bounds):
            if setting.optional and (name is None or path in self._boxes):
                self._add_automatic(setting)
            handle = self._add_slider(setting, label, current)
        else:
            handle = add_input(self._host, setting, label, current)
        self._inputs[path] = handle
        moves = isinstance(handle, viser.GuiSliderHandle | viser.GuiNumberHandle)
        if moves and self._numbers is not None:
            self._numbers.add(handle, setting.bounds, lambda number: self._type(setting, number))

        on_choice(handle, lambda value: self._change(setting, value, moves=moves))

    def _add_slider(
        self, setting: Field, label: str, current: float | None
    ) -> viser.GuiInputHandle[float]:
        bounds = setting.bounds
        assert bounds is not None
        low, high = bounds.slider_range
        whole = setting.kind is int
        start = _slider_start(bounds) if current is None else current
        # A value from a file may lie beyond the stretch that the slider is made for.
        low, high = min(low, start), max(high, start)
        unit = f" {bounds.unit}" if bounds.unit else ""
        default: Any = get_path(self._default, setting.path)
        default_text = "automatic" if default is None else f"{default:g}{unit} (the mark)"
        kind: Any = int if whole else float
        handle = self._host.gui.add_slider(
            label,
            min=kind(low),
            max=kind(high),
            step=kind(_finest(bounds, whole=whole)),
            initial_value=kind(start),
            marks=() if default is None else (kind(default),),
            disabled=current is None,
            visible=current is not None,
            hint=f"{setting.doc} Default: {default_text}. Allowed: {bounds.range}.",
        )
        if bounds.spans_decades:
            self._decades.append(handle)
        return handle

    def _add_automatic(self, setting: Field) -> None:
        current = get_path(self._value, setting.path)
        label = self._boxes.get(setting.path) or self._automatic_label(setting)
        box = self._host.gui.add_checkbox(label, current is None, hint=setting.doc)
        self._automatic[setting.path] = box

        def choose(automatic: bool) -> None:
            slider: Any = self._inputs[setting.path]
            number = get_path(self._used, setting.path)
            if automatic or number is not None:
                self._set(setting, None if automatic else number)
            else:
                self._change(setting, slider.value)

        on_choice(box, choose)

    def with_moved(self, params: P, widget: str, raw: float) -> P:
        """Give params with the value at which a slider of this panel stands.

        Args:
            params: The others.
            widget: By which a page knows the slider; of another panel it changes nothing.
            raw: As the page says it.

        Raises:
            InputError: If the value is refused.
        """
        for path, handle in self._inputs.items():
            if uuid_of(handle) == widget:
                return with_path(params, path, _rounded(self._settings[path], raw))
        return params

    def _type(self, setting: Field, number: float) -> None:
        """Take a number that was typed; the slider reaches it."""
        self._change(setting, number)
        self._show(setting, get_path(self._used, setting.path), automatic=False)

    def _change(self, setting: Field, raw: object, *, moves: bool = False) -> None:
        self._set(setting, _rounded(setting, raw), moves=moves)

    def _set(self, setting: Field, value: object, *, moves: bool = False) -> None:
        """Set a parameter; None makes it automatic, and keeps its number until a fit is done."""
        try:
            self._value = with_path(self._value, setting.path, value)
        except InputError as error:
            if self._on_error is not None:
                self._on_error(str(error))
            return
        if value is not None:
            self._used = with_path(self._used, setting.path, value)
        box, slider = self._automatic.get(setting.path), self._inputs[setting.path]
        if box is not None:
            box.value = value is None
            slider.visible, slider.disabled = True, False
        self._fit_ranges(setting)
        self._mark()
        (self._on_move if moves else self._on_change)(self._value)

    def _fit_ranges(self, moved: Field) -> None:
        """Let each slider reach its value, and give those that need it no more their range back.

        The one that was moved may be under a hand: its range grows, but does not shrink.
        """
        for path, setting in self._settings.items():
            handle = self._inputs[path]
            if isinstance(handle, viser.GuiSliderHandle):
                self._fit_range(setting, handle, get_path(self._used, path), grow=setting is moved)

    @staticmethod
    def _fit_range(
        setting: Field, handle: viser.GuiSliderHandle[Any], value: object, *, grow: bool
    ) -> None:
        assert setting.bounds is not None
        kind: Any = setting.kind if setting.kind is int else float
        low, high = map(kind, setting.bounds.slider_range)
        if isinstance(value, int | float):
            low, high = min(low, kind(value)), max(high, kind(value))
        if grow:
            low, high = min(low, handle.min), max(high, handle.max)
        # Only what differs is sent to the pages.
        if handle.min != low:
            handle.min = low
        if handle.max != high:
            handle.max = high

    def _show(self, setting: Field, value: object, *, automatic: bool) -> None:
        handle: Any = self._inputs[setting.path]
        box = self._automatic.get(setting.path)
        if box is not None:
            box.value = automatic
            box.visible = setting.path not in self._hidden
            handle.disabled = value is None
        handle.visible = value is not None and setting.path not in self._hidden
        if value is None:
            return
        if isinstance(handle, viser.GuiSliderHandle):
            self._fit_range(setting, handle, value, grow=True)
            handle.value = value  # within both ranges
            self._fit_range(setting, handle, value, grow=False)
        else:
            handle.value = value


def _rounded(setting: Field, raw: object) -> object:
    """Round what a slider says to a step."""
    if setting.bounds is None or isinstance(raw, bool) or not isinstance(raw, int | float):
        return raw
    value = setting.bounds.round(float(raw))
    # The first position of a slider need not be a whole number of steps from zero.
    value = min(max(value, setting.bounds.low), setting.bounds.high)
    return int(value) if setting.kind is int else value


def _finest(bounds: Bounds, *, whole: bool) -> float:
    """Give the step of a slider: one over decades shows as many digits at its lower end."""
    if whole or not bounds.spans_decades:
        return bounds.step
    return float(10.0 ** (math.floor(math.log10(bounds.slider_range[0])) + 1 - DIGITS))


def _slider_start(bounds: Bounds) -> float:
    """Where the slider of an automatic parameter waits: low in its range, on a step."""
    low, high = bounds.slider_range
    start = low * (high / low) ** 0.25 if bounds.spans_decades else low + 0.25 * (high - low)
    return max(low, bounds.round(start))
