"""A frozen dataclass -> widgets: bounds, unit, text and default of each stand in its field."""

import math
from collections.abc import Callable, Collection, Mapping
from contextlib import nullcontext
from dataclasses import dataclass
from typing import Any, Generic, TypeVar, get_args, get_type_hints

import viser

from app.viewer.server.host import Host
from app.viewer.session.state import Widget
from app.viewer.widgets.actions import on_choice
from app.viewer.widgets.html import show_as_eyes, uuid_of
from app.viewer.widgets.numbers import Chip, Numbers
from gpgrad_core.errors import InputError
from gpgrad_core.params import DIGITS, Bounds, Field, get_path, parameters_of, with_path, with_unit

P = TypeVar("P")


@dataclass(eq=False)
class _Row:
    """The widgets of a field; one that may be automatic has a box for that."""

    field: Field
    widget: Widget
    handle: Any
    box: viser.GuiInputHandle[bool] | None = None


class Panel(Generic[P]):
    """A widget for each field of a dataclass and of its groups; reports the whole new value.

    What is rarely needed lies below in a folded folder, and there each group in one of its own.
    Callbacks run in the server's event loop: they must only hand the value on.
    """

    def __init__(
        self,
        host: Host,
        value: P,
        on_change: Callable[[P], None],
        *,
        widgets: Mapping[str, Widget] | None = None,
        folder: str = "More options",
        below: Mapping[str, Callable[[], None]] | None = None,
        implied: Callable[[P], P] = lambda value: value,
        numbers: Numbers | None = None,
        used: P | None = None,
        default: P | None = None,
        on_move: Callable[[P], None] | None = None,
        on_error: Callable[[str], None] = lambda why: None,  # noqa: ARG005
    ) -> None:
        """Make the widgets in the current container.

        ``widgets`` says how fields are offered, by their paths, if their annotations have none;
        those of groups that are not among them lie in the folder. ``below`` makes other widgets:
        below that of a field, by its path, or first in the folder, by its title. ``implied``
        returns a value with what it implies, which decides what unfolds. ``used`` has numbers for
        what is automatic, which the sliders show. To the default sliders have marks and chips; None
        makes none of them. ``on_move`` takes the place of ``on_change`` while a slider is being
        dragged, and ``on_error`` has the message if a value is refused.
        """
        self.value, self.used = value, value if used is None else used
        self._host, self._numbers, self._implied, self._default = host, numbers, implied, default
        self._on_change, self._on_error = on_change, on_error
        self._on_move = on_move or on_change
        self._hidden: Collection[str] = ()
        self._rows: dict[str, _Row] = {}
        self._widgets = widgets_of(type(value)) if widgets is None else widgets
        below = below or {}
        groups: dict[str, list[Field]] = {}
        for field in parameters_of(type(value)):
            widget = self._widget_of(field)
            if not widget.offered:
                continue
            if not widget.folded:
                self._add(field)
                below.get(field.path, lambda: None)()
            if widget.folded or (field.optional and not widget.automatic):
                groups.setdefault(field.path.rpartition(".")[0], []).append(field)
        if groups:
            with host.gui.add_folder(folder, expand_by_default=False):
                below.get(folder, lambda: None)()
                for group, fields in groups.items():
                    self._add_group(_words(group.rpartition(".")[2]), fields)
        rows = self._rows.values()
        eyes = [row.handle for row in rows if row.widget.eye]
        if eyes:
            show_as_eyes(host, eyes, [row.handle for row in rows if row.widget.under])
        self._show()

    def set(self, value: P, used: P | None = None) -> None:
        """Show another value, with numbers for what is automatic; ``on_change`` is not called."""
        only_numbers, self.value = value == self.value, value
        self.used = value if used is None else used
        held = [
            row
            for path, row in self._rows.items()
            if only_numbers and get_path(value, path) == get_path(self.used, path)
        ]
        self._show(held, write=True)

    def reset(self) -> P:
        """Reset to the default; returns it, ``on_change`` is not called."""
        assert self._default is not None
        self.set(self._default)
        return self._default

    def adapt(self, default: P, hidden: Collection[str], automatic: Mapping[str, str]) -> None:
        """Adapt to another method: its default, unused paths, and labels of boxes by path."""
        self._default, self._hidden = default, hidden
        for path, row in self._rows.items():
            if row.box is not None:
                row.box.label = automatic.get(path) or _automatic_label(row.field, row.widget)
        self._show()

    def offer(self, path: str, choices: tuple[str, ...]) -> None:
        """Set the choices of an option, which may depend on the dataset."""
        self._rows[path].handle.options = choices
        self._write(self._rows[path])

    def uuid_of(self, path: str) -> str:
        return uuid_of(self._rows[path].handle)

    def with_moved(self, value: P, widget: str, number: float) -> P:
        """Copy another value with the number of one of our sliders, which may be an InputError."""
        for path, row in self._rows.items():
            if uuid_of(row.handle) == widget:
                return with_path(value, path, _rounded(row.field, number))
        return value

    def _widget_of(self, field: Field) -> Widget:
        return self._widgets.get(field.path) or Widget(folded="." in field.path)

    def _add_group(self, title: str, fields: list[Field]) -> None:
        """Add a folder for a group, if it has a title; what stands above has only its box there."""
        with self._host.gui.add_folder(title) if title else nullcontext():
            for field in fields:
                row = self._rows.get(field.path)
                if row is None:
                    self._add(field)
                else:
                    row.box = self._add_box(field, row.widget)

    def _add(self, field: Field) -> None:
        widget, slides = self._widget_of(field), _has_slider(field.bounds)
        label = with_unit(widget.label or _words(field.name), field.bounds)
        boxed = slides and field.optional and (widget.folded or widget.automatic)
        box = self._add_box(field, widget) if boxed else None
        handle = self._add_slider(field, label) if slides else self._add_input(field, widget, label)
        row = self._rows[field.path] = _Row(field, widget, handle, box)
        moves = isinstance(handle, viser.GuiSliderHandle | viser.GuiNumberHandle)
        if moves and self._numbers is not None:

            def take(number: float) -> None:
                self._set(row, _rounded(field, number))
                self._write(row)

            self._numbers.add(handle, field.bounds, take, lambda: self._go_back(field))
        values = {text: choice for choice, text in widget.names.items()}
        on_choice(
            handle,
            lambda raw: self._set(row, _rounded(field, values.get(raw, raw)), moves=moves),
        )

    def _add_input(self, field: Field, widget: Widget, label: str) -> viser.GuiInputHandle[Any]:
        gui, bounds, kind = self._host.gui, field.bounds, field.kind
        value: Any = get_path(self.used, field.path)
        if isinstance(kind, tuple):
            choices = tuple(widget.names.get(choice, choice) for choice in kind)
            shown = widget.names.get(value, str(value))
            return gui.add_dropdown(label, choices, initial_value=shown, hint=field.doc)
        if kind is bool:
            return gui.add_checkbox(label, bool(value), hint=field.doc)
        if bounds is None:
            return gui.add_number(label, value, hint=field.doc)
        return gui.add_number(
            label, value, min=kind(bounds.low), max=kind(bounds.high), hint=field.doc
        )

    def _add_slider(self, field: Field, label: str) -> viser.GuiInputHandle[Any]:
        bounds, kind = field.bounds, field.kind
        assert bounds is not None
        assert isinstance(kind, type)
        current: Any = get_path(self.used, field.path)
        start = _slider_start(bounds) if current is None else current
        # A value from a file may lie beyond the range that the slider is meant for.
        low, high = min(bounds.slider_range[0], start), max(bounds.slider_range[1], start)
        hint, default = field.doc, None
        if self._default is not None:
            default = get_path(self._default, field.path)
            unit = f" {bounds.unit}" if bounds.unit else ""
            text = "automatic" if default is None else f"{default:g}{unit} (the mark)"
            hint = f"{hint} Default: {text}. Allowed: {bounds.range}."
        return self._host.gui.add_slider(
            label,
            min=kind(low),
            max=kind(high),
            step=kind(_finest(bounds, whole=kind is int)),
            initial_value=kind(start),
            marks=() if default is None else (kind(default),),
            hint=hint,
        )

    def _add_box(self, field: Field, widget: Widget) -> viser.GuiInputHandle[bool]:
        label = _automatic_label(field, widget)
        is_automatic = get_path(self.value, field.path) is None
        box = self._host.gui.add_checkbox(label, is_automatic, hint=field.doc)

        def choose(automatic: bool) -> None:
            row, number = self._rows[field.path], get_path(self.used, field.path)
            if not automatic and number is None:
                number = _rounded(field, row.handle.value)
            self._set(row, None if automatic else number)

        on_choice(box, choose)
        return box

    def _set(self, row: _Row, value: object, *, moves: bool = False) -> None:
        """Set a field; None makes it automatic, and keeps its number until a fit is done."""
        try:
            self.value = with_path(self.value, row.field.path, value)
        except InputError as error:
            self._on_error(str(error))
            return
        if value is not None:
            self.used = with_path(self.used, row.field.path, value)
        self._show((row,))
        (self._on_move if moves else self._on_change)(self.value)

    def _go_back(self, field: Field) -> None:
        default, used = get_path(self._default, field.path), self.used
        value = with_path(self.value, field.path, default)
        self.set(value, used if default is None else with_path(used, field.path, default))
        self._on_change(value)

    def _show(self, held: Collection[_Row] = (), *, write: bool = False) -> None:
        """Show what there is; rows under a hand keep their value, and their ranges only grow."""
        implied = self._implied(self.value)
        for path, row in self._rows.items():
            number = get_path(self.used, path)
            applies = path not in self._hidden and self._applies(row.widget, implied)
            if row.box is not None:
                row.box.value = get_path(self.value, path) is None
                row.box.visible = applies
            row.handle.visible = applies and number is not None
            row.handle.disabled = number is None
            if write and row not in held:
                self._write(row)
            else:
                self._fit_range(row, grow=row in held)
        if self._numbers is not None and self._default is not None:
            sliders = [row for row in self._rows.values() if _has_slider(row.field.bounds)]
            self._numbers.show_chips({uuid_of(row.handle): self._chip(row) for row in sliders})

    def _applies(self, widget: Widget, implied: P) -> bool:
        needed = widget.needs.items()
        return all(getattr(self.value, other) in values for other, values in needed) and (
            not widget.under or any(getattr(implied, other) for other in widget.under)
        )

    def _chip(self, row: _Row) -> Chip:
        value, default, used = (
            get_path(params, row.field.path) for params in (self.value, self._default, self.used)
        )
        # With the noise, its growth is chosen too, though it has a number when it is not.
        if value is None or (value == default and used != value):
            return Chip("auto", "Automatic: chosen for this dataset by its points.")
        if value == default:
            return Chip("default", "As the dataset was opened.")
        to = "automatic" if default is None else f"the default, {default:g}"
        return Chip("set ↺", f"Set by hand. Press to go back to {to}.", back=True)

    def _write(self, row: _Row) -> None:
        """Set a widget to its value, and its range to fit that."""
        value: Any = get_path(self.used, row.field.path)
        if value is not None:
            self._fit_range(row, grow=True)
            row.handle.value = row.widget.names.get(value, value)  # within both ranges
        self._fit_range(row)

    def _fit_range(self, row: _Row, *, grow: bool = False) -> None:
        """Let a slider reach its value, and give it back the range that it needs no more."""
        bounds, handle, kind = row.field.bounds, row.handle, row.field.kind
        if bounds is None or not isinstance(handle, viser.GuiSliderHandle):
            return
        assert isinstance(kind, type)
        value: Any = get_path(self.used, row.field.path)
        ends = list(bounds.slider_range)
        ends += [] if value is None else [value]
        ends += [handle.min, handle.max] if grow else []
        handle.min, handle.max = kind(min(ends)), kind(max(ends))


def widgets_of(options: type) -> dict[str, Widget]:
    """The widget of each field of a dataclass, by name, where its annotation has one."""
    return {
        name: extra
        for name, hint in get_type_hints(options, include_extras=True).items()
        for extra in get_args(hint)
        if isinstance(extra, Widget)
    }


def _has_slider(bounds: Bounds | None) -> bool:
    """Whether a number has a slider, and is not typed: it has bounds, and none is skipped."""
    if bounds is None:
        return False
    low, high = bounds.slider_range
    return high - low <= 1_000_000 * bounds.step  # what has more, such as a seed, is typed


def _automatic_label(field: Field, widget: Widget) -> str:
    """Name the box of a number that may be automatic: short, so that boxes are below each other."""
    return widget.automatic or f"Auto {(widget.label or _words(field.name)).lower()}"


def _words(name: str) -> str:
    """Write a name of code for people.

    >>> _words("max_points")
    'Max points'
    """
    return name.replace("_", " ").capitalize()


def _rounded(field: Field, raw: object) -> object:
    if isinstance(raw, bool) or not isinstance(raw, int | float):
        return raw
    return field.rounded(raw)


def _finest(bounds: Bounds, *, whole: bool) -> float:
    """The step of a slider: one over decades shows as many digits at its lower end."""
    if whole or not bounds.spans_decades:
        return bounds.step
    return float(10.0 ** (math.floor(math.log10(bounds.slider_range[0])) + 1 - DIGITS))


def _slider_start(bounds: Bounds) -> float:
    """Where the slider of an automatic parameter waits: low in its range, on a step."""
    low, high = bounds.slider_range
    start = low * (high / low) ** 0.25 if bounds.spans_decades else low + 0.25 * (high - low)
    return max(low, bounds.round(start))
