"""What is shown, as the part of an address behind ``#``; and such a part read again.

The server of the page never sees that part, and viser, which reads words of its own behind ``?``,
leaves it alone. It comes from outside: every value is checked as those of files are.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from urllib.parse import parse_qsl, quote

from app.viewer.draw.placement import Camera
from app.viewer.feature import Subject
from app.viewer.methods import METHODS
from app.viewer.session_file import SavedSession, check_method
from app.viewer.state import ViewOptions, ViewState
from gpgrad_core.datasets import demo_path
from gpgrad_core.errors import InputError
from gpgrad_core.params.fields import AUTOMATIC, Field, get_path, parameters_of
from gpgrad_core.params.files import with_tables
from gpgrad_core.pipeline import PipelineParams
from gpgrad_core.reading.paths import check_path
from gpgrad_core.types import MAX_COORDINATE

LONGEST = 3500
"""Characters of such a part; what tells it to the server takes little more."""
LONGEST_NUMBER = 40
MOST_ENTRIES = 200
WHERE = "the link"
PERSONAL = ("dark",)
"""Options of the view that are the reader's own."""


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
    mine = options or ViewOptions()
    own = {name: getattr(mine, name) for name in PERSONAL}
    view = replace(_params(given, "view.", ViewOptions()), **own)
    method = check_method(given.pop("method", None), WHERE)
    params = _params(given, "params.", METHODS[method].adapt(PipelineParams()))
    dataset, camera = given.pop("dataset", None), given.pop("camera", None)
    query, database = given.pop("query", None), given.pop("database", None)
    scene = given.pop("scene", "pair")
    if given:
        raise InputError(f"{WHERE}: unknown word {next(iter(given))[:40]!r}")
    if scene not in ("pair", "world"):
        raise InputError(f"{WHERE}: scene must be pair or world, got {scene[:40]!r}")
    saved = SavedSession(
        None if dataset is None else _path(dataset),
        query,
        database,
        view,
        params,
        None if camera is None else _camera(camera),
        method=method,
    )
    return Link(saved, "world" if scene == "world" else "pair")


def _text_of(value: object) -> str:
    if value is None:
        return AUTOMATIC
    # repr of a float is the shortest text that reads back as the same number.
    return str(value).lower() if isinstance(value, bool) else str(value)


def _params(given: dict[str, str], prefix: str, base: Any) -> Any:
    """Take the entries that begin with a prefix out, and put their values into params."""
    fields = {field.path: field for field in parameters_of(type(base))}
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
    return with_tables(base, tables, WHERE)


def _value(field: Field, text: str) -> object:
    if isinstance(field.kind, tuple) or (field.optional and text == AUTOMATIC):
        return text
    if field.kind is bool:
        known = {"true": True, "false": False}
        if text not in known:
            raise InputError(f"{WHERE}: {field.path} must be true or false, got {text[:40]!r}")
        return known[text]
    return _number(text, field.path, int if field.kind is int else float)


def _number(text: str, name: str, kind: Callable[[str], float]) -> float:
    try:
        if len(text) > LONGEST_NUMBER:
            raise ValueError
        number = kind(text)
    except ValueError:
        raise InputError(f"{WHERE}: {name} must be a number, got {text[:40]!r}") from None
    if not abs(number) < float("inf"):  # NaN is not below anything
        raise InputError(f"{WHERE}: {name} must be a number, got {text[:40]!r}")
    return number


def _path(text: str) -> Path:
    try:
        return check_path(text)
    except InputError as error:
        raise InputError(f"{WHERE}: dataset: {error}") from None


def _camera(text: str) -> Camera:
    parts = text.split(",")
    if len(parts) != 6:
        raise InputError(f"{WHERE}: camera must be six numbers, got {text[:40]!r}")
    x, y, z, u, v, w = (_number(part, "camera", float) for part in parts)
    if max(map(abs, (x, y, z, u, v, w))) > MAX_COORDINATE or (x, y, z) == (u, v, w):
        raise InputError(f"{WHERE}: camera cannot be at {text[:60]}")
    return Camera((x, y, z), (u, v, w))
