"""A params dataclass -> sliders: bounds, unit, tooltip and default all come from its fields."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, is_dataclass, replace
from typing import (
    Annotated,
    Any,
    Generic,
    Literal,
    TypeVar,
    cast,
    get_args,
    get_origin,
    get_type_hints,
)

import viser
from typing_extensions import Doc

from app.host import Host
from gpgrad_core.bounds import Bounds
from gpgrad_core.errors import InputError

P = TypeVar("P")


@dataclass(frozen=True)
class Setting:
    """One parameter as the panel sees it.

    Attributes:
        path: Where it lies in the params, such as ``map.length_scale``.
        kind: ``bool``, ``int`` or ``float``, or the values of a choice.
        bounds: Of a number; None if it has none.
        optional: Whether None, "automatic", is a value too.
        doc: One sentence for the tooltip.
    """

    path: str
    kind: type | tuple[str, ...]
    bounds: Bounds | None
    optional: bool
    doc: str

    @property
    def label(self) -> str:
        """Its name in words, with the unit."""
        return with_unit(self.path.rpartition(".")[2].replace("_", " "), self.bounds)


def with_unit(name: str, bounds: Bounds | None) -> str:
    """Write a name with its unit: ``noise std [m]``."""
    return f"{name} [{bounds.unit}]" if bounds is not None and bounds.unit else name


def settings_of(params: type, prefix: str = "") -> tuple[Setting, ...]:
    """List the parameters of a dataclass, those of dataclasses within it included.

    A field of a type that no widget shows is an error here, not a slider missing there.

    Raises:
        TypeError: If a field is neither a number, a truth value, a choice nor a dataclass.
    """
    found: list[Setting] = []
    hints = get_type_hints(params, include_extras=True)
    for field in fields(params):
        hint, path = hints[field.name], prefix + field.name
        extras: tuple[Any, ...] = ()
        if get_origin(hint) is Annotated:
            hint, *rest = get_args(hint)
            extras = tuple(rest)
        bounds = next((extra for extra in extras if isinstance(extra, Bounds)), None)
        doc = next((extra.documentation for extra in extras if isinstance(extra, Doc)), "")
        members = get_args(hint)
        optional = type(None) in members
        if optional:
            hint = next(member for member in members if member is not type(None))
        if isinstance(hint, type) and is_dataclass(hint):
            found += settings_of(hint, path + ".")
        elif get_origin(hint) is Literal:
            choices = tuple(str(choice) for choice in get_args(hint))
            found.append(Setting(path, choices, None, optional, doc))
        elif hint in (bool, int, float):
            found.append(Setting(path, hint, bounds, optional, doc))
        else:
            raise TypeError(f"{params.__name__}.{field.name}: no widget shows a {hint}")
    return tuple(found)


def get_path(params: object, path: str) -> object:
    """Read a parameter: ``get_path(params, "map.length_scale")``."""
    for name in path.split("."):
        params = getattr(params, name)
    return params


def with_path(params: P, path: str, value: object) -> P:
    """Copy params with one parameter changed.

    Raises:
        InputError: If the value lies outside its bounds.
    """
    name, _, rest = path.partition(".")
    inner = with_path(getattr(params, name), rest, value) if rest else value
    return cast("P", replace(cast("Any", params), **{name: inner}))


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
        folder: str = "More parameters",
        on_error: Callable[[str], None] | None = None,
    ) -> None:
        """Make the widgets in the current container.

        Args:
            host: Whose GUI they join.
            value: What they start at, and what "default" means until `set_default`.
            on_change: Given the whole new value after each change by a user.
            main: Paths of the parameters that stand outside the folder, in this order, and
                their names for people (the unit is added).
            folder: Title of the folder of all others.
            on_error: Given the message if a value is refused.
        """
        self._host = host
        self._default = value
        self._value = value
        self._on_change = on_change
        self._on_error = on_error
        self._inputs: dict[str, viser.GuiInputHandle[Any]] = {}
        self._automatic: dict[str, viser.GuiInputHandle[bool]] = {}
        self._settings = {setting.path: setting for setting in settings_of(type(value))}
        for path, name in main.items():
            self._add(self._settings[path], name)
        others = [setting for path, setting in self._settings.items() if path not in main]
        if others:
            with host.gui.add_folder(folder, expand_by_default=False):
                self._add_groups(others)

    @property
    def value(self) -> P:
        """The params as the widgets show them."""
        return self._value

    def set(self, value: P) -> None:
        """Show other params; ``on_change`` is not called."""
        self._value = value
        for path, setting in self._settings.items():
            self._show(setting, get_path(value, path))

    def reset(self) -> P:
        """Go back to the defaults; returns them, ``on_change`` is not called."""
        self.set(self._default)
        return self._default

    def set_default(self, value: P) -> None:
        """Say what `reset` goes back to."""
        self._default = value

    def _add_groups(self, settings: list[Setting]) -> None:
        groups: dict[str, list[Setting]] = {}
        for setting in settings:
            groups.setdefault(setting.path.partition(".")[0], []).append(setting)
        for group, members in groups.items():
            with self._host.gui.add_folder(group.replace("_", " ").capitalize()):
                for setting in members:
                    self._add(setting, None)

    def _add(self, setting: Setting, name: str | None) -> None:
        gui, path = self._host.gui, setting.path
        label = with_unit(name, setting.bounds) if name else setting.label
        current: Any = get_path(self._value, path)
        if isinstance(setting.kind, tuple):
            handle: Any = gui.add_dropdown(
                label, setting.kind, initial_value=str(current), hint=setting.doc
            )
        elif setting.kind is bool:
            handle = gui.add_checkbox(label, bool(current), hint=setting.doc)
        elif setting.bounds is None:
            handle = gui.add_number(label, current, hint=setting.doc)
        else:
            if setting.optional:
                self._add_automatic(setting, label, current)
            handle = self._add_slider(setting, label, current)
        self._inputs[path] = handle

        # Asynchronous, so that the server runs it in order in its event loop; plain functions
        # would go to a pool of threads and could overtake each other.
        @handle.on_update
        async def _(event: viser.GuiEvent[Any]) -> None:
            if event.client_id is not None:  # else it is our own `set`
                self._change(setting, event.target.value)

    def _add_slider(
        self, setting: Setting, label: str, current: float | None
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
        default_text = "automatic" if default is None else f"{default:g}{unit}"
        kind: Any = int if whole else float
        return self._host.gui.add_slider(
            label,
            min=kind(low),
            max=kind(high),
            step=kind(bounds.step),
            initial_value=kind(start),
            marks=() if default is None else (kind(default),),
            disabled=current is None,
            hint=f"{setting.doc} Default: {default_text} (the mark). "
            f"Allowed: {bounds.low:g} to {bounds.high:g}{unit}.",
        )

    def _add_automatic(self, setting: Setting, label: str, current: float | None) -> None:
        box = self._host.gui.add_checkbox(
            f"automatic {label.partition(' [')[0]}", current is None, hint=setting.doc
        )
        self._automatic[setting.path] = box

        @box.on_update
        async def _(event: viser.GuiEvent[Any]) -> None:
            if event.client_id is None:
                return
            slider: Any = self._inputs[setting.path]
            slider.disabled = event.target.value
            self._change(setting, None if event.target.value else slider.value)

    def _change(self, setting: Setting, raw: object) -> None:
        value = raw
        if setting.bounds is not None and isinstance(raw, int | float):
            value = setting.bounds.round(float(raw))
            # The first position of a slider need not be a whole number of steps from zero.
            value = min(max(value, setting.bounds.low), setting.bounds.high)
            value = int(value) if setting.kind is int else value
        try:
            self._value = with_path(self._value, setting.path, value)
        except InputError as error:
            if self._on_error is not None:
                self._on_error(str(error))
            return
        self._on_change(self._value)

    def _show(self, setting: Setting, value: object) -> None:
        handle: Any = self._inputs[setting.path]
        box = self._automatic.get(setting.path)
        if box is not None:
            box.value = value is None
            handle.disabled = value is None
        if value is None:
            return
        if setting.bounds is not None and isinstance(value, int | float):
            handle.min = min(handle.min, value)
            handle.max = max(handle.max, value)
        handle.value = value


def _slider_start(bounds: Bounds) -> float:
    """Where the slider of an automatic parameter waits: low in its range, on a step."""
    low, high = bounds.slider_range
    return max(low, bounds.round(low + 0.25 * (high - low)))
