"""What is shown, as the part of an address behind ``#``; and such a part read again.

The server of the page never sees that part, and viser, which reads words of its own behind ``?``,
leaves it alone. It comes from outside: every value is checked as those of files are.
"""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeAlias
from urllib.parse import parse_qsl, quote

import msgspec

from app.viewer.session.methods import METHODS
from app.viewer.session.news import Subject
from app.viewer.session.session_file import Coordinate, SavedSession, as_saved
from app.viewer.session.state import Camera, ViewOptions, ViewState
from gpgrad_core.detection import PipelineParams
from gpgrad_core.errors import InputError
from gpgrad_core.params import AUTOMATIC, Field, get_path, parameters_of
from gpgrad_core.reading.records import Finite
from gpgrad_core.simulation.demo import demo_path

LONGEST = 3500
"""Characters of such a part; what tells it to the server takes little more."""
MOST_ENTRIES = 200
WHERE = "the link"
PERSONAL = ("dark",)
"""Options of the view that are the reader's own."""
WORDS = ("dataset", "query", "database", "method")
"""Of an address, as they stand in a saved session; others are taken apart first."""
CameraNumbers: TypeAlias = tuple[
    Coordinate, Coordinate, Coordinate, Coordinate, Coordinate, Coordinate
]


@dataclass(frozen=True, eq=False)
class Link:
    """What an address asks for.

    Attributes:
        saved: Dataset, pair, parameters, view and camera.
        subject: What the scene shows.
    """

    saved: SavedSession
    subject: Subject = "pair"


def address_of(state: ViewState, subject: Subject = "pair", camera: Camera | None = None) -> str:
    """Write what is shown.

    All parameters are named that are not the method's own. What is automatic is fitted where the
    link is opened, and gives the same numbers there, because it depends on the dataset alone.

    Args:
        state: The session.
        subject: What the scene shows.
        camera: Of the page; None lets the reader's page choose.

    Returns:
        The part of the address; empty if the dataset has no path, or it would be too long.
    """
    if not state.source:
        return ""
    entries: list[tuple[str, str]] = []
    if Path(state.source) != demo_path():
        entries.append(("dataset", str(Path(state.source).absolute())))
    entries.append(("query", state.query_id))
    if state.is_pair:
        entries.append(("database", state.database_id))
    if subject != "pair":
        entries.append(("scene", subject))
    if state.method != SavedSession.method:
        entries.append(("method", state.method))
    for group, values, base in (
        ("view", state.options, ViewOptions()),
        ("params", state.asked, METHODS[state.method].adapt(PipelineParams())),
    ):
        for field in parameters_of(type(base)):
            value = get_path(values, field.path)
            if value != get_path(base, field.path) and field.path not in PERSONAL:
                entries.append((f"{group}.{field.path}", _text_of(value)))
    if camera is not None:
        # Rounded, and never -0: what a camera's turns leave of a zero is no place.
        numbers = (round(float(number), 4) + 0.0 for number in (*camera.position, *camera.look_at))
        entries.append(("camera", ",".join(f"{number:.4g}" for number in numbers)))
    text = "&".join(f"{key}={quote(value, safe='/:,.')}" for key, value in entries)
    return text if len(text) <= LONGEST else ""


def read_address(text: str, options: ViewOptions | None = None) -> Link:
    """Read what an address asks for.

    Args:
        text: What is behind ``#``.
        options: Of the view, for what is the reader's own; None takes the usual.

    Raises:
        InputError: If a word is not known, or a value cannot be.
    """
    if len(text) > LONGEST:
        raise InputError(f"{WHERE}: may have {LONGEST:,} characters, got {len(text):,}")
    try:
        pairs = parse_qsl(
            text, keep_blank_values=True, strict_parsing=True, max_num_fields=MOST_ENTRIES
        )
    except ValueError as error:
        raise InputError(f"{WHERE}: is not made of name=value, joined by &") from error
    given = dict(pairs)
    if len(given) < len(pairs):
        raise InputError(f"{WHERE}: says the same thing twice")
    subject = _as("scene", given.pop("scene", "pair"), Subject, "pair or world")
    table: dict[str, object] = {
        "view": _take_tables(given, "view.", ViewOptions),
        "params": _take_tables(given, "params.", PipelineParams),
    }
    if "camera" in given:
        table["camera"] = _camera(given.pop("camera"))
    for key in given:
        if key not in WORDS:
            raise InputError(f"{WHERE}: unknown word {key[:40]!r}")
    saved = as_saved(given | table, WHERE)
    own = {name: getattr(options or ViewOptions(), name) for name in PERSONAL}
    return Link(replace(saved, options=replace(saved.options, **own)), subject)


def _text_of(value: object) -> str:
    if value is None:
        return AUTOMATIC
    # repr of a float is the shortest text that reads back as the same number.
    return str(value).lower() if isinstance(value, bool) else str(value)


def _take_tables(given: dict[str, str], prefix: str, kind: type) -> dict[str, Any]:
    """Take the entries that begin with a prefix out, as nested tables of values."""
    fields = {field.path: field for field in parameters_of(kind)}
    tables: dict[str, Any] = {}
    for key in [key for key in given if key.startswith(prefix)]:
        path, text = key.removeprefix(prefix), given.pop(key)
        if path not in fields:
            raise InputError(f"{WHERE}: unknown parameter {path[:60]!r}")
        *groups, name = path.split(".")
        table = tables
        for group in groups:
            table = table.setdefault(group, {})
        table[name] = _value(fields[path], text)
    return tables


def _value(field: Field, text: str) -> object:
    if isinstance(field.kind, tuple) or (field.optional and text == AUTOMATIC):
        return text
    if field.kind is bool:
        return _as(field.path, text, bool, "true or false")
    kind = int if field.kind is int else Finite
    return _as(field.path, text, kind, "a whole number" if kind is int else "a number")


def _camera(text: str) -> dict[str, tuple[float, ...]]:
    """Read six numbers: where a camera stands, and what it looks at."""
    numbers = _as("camera", text, CameraNumbers, "six numbers that are places")
    if numbers[:3] == numbers[3:]:
        raise InputError(f"{WHERE}: camera cannot be at {text[:60]}")
    return {"position": numbers[:3], "look_at": numbers[3:]}


def _as(name: str, text: str, kind: Any, rule: str) -> Any:
    """Read a text of an address as a value of a kind."""
    try:
        parts = text.split(",") if kind is CameraNumbers else text
        return msgspec.convert(parts, kind, strict=False)
    except msgspec.ValidationError:
        raise InputError(f"{WHERE}: {name} must be {rule}, got {text[:40]!r}") from None
