"""A frozen dataclass of options -> widgets: what one shows and takes stands in its field."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any, Generic, TypeVar, get_args, get_type_hints

import viser

from app.viewer.server.host import Host
from app.viewer.session.state import Widget
from app.viewer.widgets.actions import on_choice
from app.viewer.widgets.html import show_as_eyes
from app.viewer.widgets.numbers import Numbers
from gpgrad_core.params import Bounds, Field, fields_of, with_unit

P = TypeVar("P")


def is_slider(bounds: Bounds | None) -> bool:
    """Say whether a number has a slider, and is not typed: it has bounds, and none is skipped."""
    if bounds is None:
        return False
    low, high = bounds.slider_range
    return high - low <= 1_000_000 * bounds.step  # what has more, such as a seed, is typed


def add_input(host: Host, field: Field, label: str, value: Any) -> viser.GuiInputHandle[Any]:
    """Make the widget of a choice, a truth value or a number."""
    gui, bounds, kind = host.gui, field.bounds, field.kind
    if isinstance(kind, tuple):
        return gui.add_dropdown(label, kind, initial_value=str(value), hint=field.doc)
    if kind is bool:
        return gui.add_checkbox(label, bool(value), hint=field.doc)
    if bounds is None:
        return gui.add_number(label, value, hint=field.doc)
    if not is_slider(bounds):
        low, high = kind(bounds.low), kind(bounds.high)
        return gui.add_number(label, value, min=low, max=high, hint=field.doc)
    low, high = map(kind, bounds.slider_range)
    return gui.add_slider(label, low, high, kind(bounds.step), value, hint=field.doc)


class OptionsPanel(Generic[P]):
    """A widget for each field of a dataclass, in their order; reports the whole new options."""

    def __init__(
        self,
        host: Host,
        options: P,
        on_change: Callable[[P], None],
        *,
        folder: str = "More options",
        below: Mapping[str, Callable[[], None]] | None = None,
        implied: Callable[[P], P] = lambda options: options,
        numbers: Numbers | None = None,
    ) -> None:
        """Make the widgets in the current container.

        Args:
            host: Whose GUI they join.
            options: What they start at. `state.Widget` says how each is offered.
            on_change: Given the whole new options after each change by a user.
            folder: Title of the folder of those that are rarely needed.
            below: By the name of a field, what makes other widgets below its own.
            implied: Gives options with what they imply, which decides what unfolds.
            numbers: Takes what is typed beside the sliders.
        """
        self.options = options
        self._host, self._on_change, self._numbers = host, on_change, numbers
        self._implied = implied
        self._handles: dict[str, viser.GuiInputHandle[Any]] = {}
        self._widgets = widgets_of(type(options))
        fields = [field for field in fields_of(type(options)) if self._widgets[field.name].offered]
        for field in fields:
            if not self._widgets[field.name].folded:
                self._add(field)
                (below or {}).get(field.name, lambda: None)()
        folded = [field for field in fields if self._widgets[field.name].folded]
        if folded:
            with host.gui.add_folder(folder, expand_by_default=False):
                for field in folded:
                    self._add(field)
        eyes = [handle for name, handle in self._handles.items() if self._widgets[name].eye]
        below_eyes = [handle for name, handle in self._handles.items() if self._widgets[name].under]
        if eyes:
            show_as_eyes(host, eyes, below_eyes)
        self._show_what_applies()

    def set(self, options: P) -> None:
        """Show other options; ``on_change`` is not called."""
        self.options = options
        for name, handle in self._handles.items():
            value = getattr(options, name)
            handle.value = self._widgets[name].names.get(value, value)
        self._show_what_applies()

    def offer(self, name: str, choices: tuple[str, ...]) -> None:
        """Give an option other choices, which may depend on the dataset."""
        handle = self._handles[name]
        assert isinstance(handle, viser.GuiDropdownHandle)
        handle.options = choices

    def _add(self, field: Field) -> None:
        widget, value = self._widgets[field.name], getattr(self.options, field.name)
        label = with_unit(widget.label or field.name.replace("_", " ").capitalize(), field.bounds)
        if isinstance(field.kind, tuple):
            choices = tuple(widget.names.get(choice, choice) for choice in field.kind)
            field, value = replace(field, kind=choices), widget.names.get(value, value)
        values = {text: choice for choice, text in widget.names.items()}
        handle = self._handles[field.name] = add_input(self._host, field, label, value)

        def change(value: Any) -> None:
            changed: Any = replace(
                self.options,  # pyright: ignore[reportArgumentType]
                **{field.name: values.get(value, value)},
            )
            self.options = changed
            self._show_what_applies()
            self._on_change(changed)

        def take(number: float) -> None:
            change(number)
            handle.value = number

        if self._numbers is not None and isinstance(handle, viser.GuiSliderHandle):
            self._numbers.add(handle, field.bounds, take)
        on_choice(handle, change)

    def _show_what_applies(self) -> None:
        implied = self._implied(self.options)
        for name, handle in self._handles.items():
            widget = self._widgets[name]
            applies = all(
                getattr(self.options, other) in values for other, values in widget.needs.items()
            ) and (not widget.under or any(getattr(implied, other) for other in widget.under))
            if handle.visible != applies:
                handle.visible = applies


def widgets_of(options: type) -> dict[str, Widget]:
    """Give how each field of a dataclass is offered, by its name."""
    return {
        name: next((extra for extra in get_args(hint) if isinstance(extra, Widget)), Widget())
        for name, hint in get_type_hints(options, include_extras=True).items()
    }
