"""A session as a file: dataset, pair, parameters, view, camera and decisions on pairs."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import cast

import tomli_w

from app.viewer.decisions import MOST_DECISIONS, Decisions, read_decisions, tables_of
from app.viewer.draw.placement import Camera
from app.viewer.methods import METHOD_NAMES, METHODS, MethodName
from app.viewer.state import (
    ViewOptions,
    ViewState,
    check_pair,
    with_method,
    with_options,
    with_pair,
    with_params,
)
from gpgrad_core.datasets import demo_path
from gpgrad_core.errors import InputError
from gpgrad_core.params.files import to_tables, with_tables
from gpgrad_core.pipeline import PipelineParams
from gpgrad_core.reading.paths import check_path
from gpgrad_core.reading.text import read_text
from gpgrad_core.reading.toml_files import parse_toml
from gpgrad_core.types import MAX_COORDINATE, Dataset

ENDING = ".gpgrad.toml"
LARGEST = 100_000
"""Bytes of such a file: a few thousand, and about 70 for each decision. What a page sends is parsed
in a thread of its own, which such a file keeps busy for a tenth of a second at most."""
KEYS = ("dataset", "query", "database", "view", "method", "params", "camera", "decisions")


@dataclass(frozen=True, eq=False)
class SavedSession:
    """What the file holds.

    Attributes:
        dataset: Path of the dataset; None is the built-in demo.
        query_id: Submap that is registered; None where the file does not say.
        database_id: Submap that it is registered to.
        options: Of the view.
        params: Of the method.
        camera: Of the page that saved it, if there was one.
        decisions: What a person decided about pairs.
        method: That runs.
    """

    dataset: Path | None = None
    query_id: str | None = None
    database_id: str | None = None
    options: ViewOptions = field(default_factory=ViewOptions)
    params: PipelineParams = field(default_factory=PipelineParams)
    camera: Camera | None = None
    decisions: Decisions = field(default_factory=Decisions)
    method: MethodName = "gradient"

    def check(self, dataset: Dataset) -> None:
        """Check that a dataset has the pair, and those that were decided.

        Raises:
            InputError: If it has not.
        """
        for name in (self.query_id, self.database_id):
            if name is not None:
                dataset.submap(name)
        check_pair(dataset, self.query_id, self.database_id)
        known = {submap.id for submap in dataset.submaps}
        for pair in self.decisions.pairs:
            for name in pair:
                if name not in known:
                    dataset.submap(name)

    def apply(self, state: ViewState) -> ViewState:
        """Apply everything that was saved to a dataset that was just opened."""
        state = with_pair(state, query_id=self.query_id, database_id=self.database_id)
        state = with_params(with_method(state, self.method), self.params)
        return with_options(state, self.options)


def session_text(
    state: ViewState, camera: Camera | None, decisions: Decisions | None = None
) -> str:
    """Write a session as TOML.

    Args:
        state: The session.
        camera: Where from to look at it.
        decisions: What a person decided about pairs.

    Raises:
        InputError: If there are more decisions than such a file takes.
    """
    table: dict[str, object] = {}
    if Path(state.source) != demo_path():
        table["dataset"] = str(Path(state.source).absolute())
    table["query"] = state.query_id
    if state.is_pair:
        table["database"] = state.database_id
    if state.method != SavedSession.method:
        table["method"] = state.method
    table["view"] = to_tables(state.options)
    if camera is not None:
        table["camera"] = {
            "position": camera.position,
            "look_at": camera.look_at,
        }
    table["params"] = to_tables(state.asked)
    decided = [] if decisions is None else tables_of(decisions)
    if decided:
        table["decisions"] = decided
    text = f"# gpgrad view --state FILE\n{tomli_w.dumps(table)}"
    if len(text.encode()) > LARGEST or len(decided) > MOST_DECISIONS:
        raise InputError(
            f"a session file has no room for {len(decided):,} decisions; export closures.json, "
            "which keeps them all"
        )
    return text


def read_session(path: Path) -> SavedSession:
    """Read a session from a file.

    Raises:
        InputError: If it cannot be read, is no such file, or names what there is not.
    """
    try:
        text = read_text(path, LARGEST)
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from error
    return parse_session(text, str(path))


def parse_session(text: str | bytes, where: str) -> SavedSession:
    """Parse the text of a saved session.

    Args:
        text: TOML, in UTF-8 if it is not decoded yet.
        where: Name of the file, for the message.

    Raises:
        InputError: As `read_session`.
    """
    table = parse_toml(text, where, LARGEST)
    unknown = [key for key in table if key not in KEYS]
    if unknown:
        raise InputError(
            f"{where}: is not a saved session: unknown key {unknown[0]}; known: {', '.join(KEYS)}"
        )
    dataset = _text(table, "dataset", where)
    method = check_method(_text(table, "method", where), where)
    base = METHODS[method].adapt(PipelineParams())
    return SavedSession(
        None if dataset is None else _path(dataset, where),
        _text(table, "query", where),
        _text(table, "database", where),
        with_tables(ViewOptions(), _table(table, "view", where), f"{where}, [view]"),
        with_tables(base, _table(table, "params", where), f"{where}, [params]"),
        _camera(_table(table, "camera", where), where) if "camera" in table else None,
        read_decisions(table["decisions"], where) if "decisions" in table else Decisions(),
        method,
    )


def check_method(name: str | None, where: str) -> MethodName:
    """Check the name of a method; None is the usual one.

    Raises:
        InputError: If the viewer runs no such method.
    """
    if name is None:
        return SavedSession.method
    for known in METHOD_NAMES:
        if name == known:
            return known
    raise InputError(f"{where}: method must be {' or '.join(METHOD_NAMES)}, got {name[:40]!r}")


def _text(table: Mapping[str, object], key: str, where: str) -> str | None:
    value = table.get(key)
    if value is not None and not isinstance(value, str):
        raise InputError(f"{where}: {key} must be a text in quotes, got {value!r}")
    return value


def _path(text: str, where: str) -> Path:
    try:
        return check_path(text)
    except InputError as error:
        raise InputError(f"{where}: dataset: {error}") from None


def _table(table: Mapping[str, object], key: str, where: str) -> Mapping[str, object]:
    value = table.get(key, {})
    if not isinstance(value, dict):
        raise InputError(f"{where}: {key} must be a table, [{key}], got {value!r}")
    return cast("Mapping[str, object]", value)


def _camera(table: Mapping[str, object], where: str) -> Camera:
    return Camera(_point(table, "position", where), _point(table, "look_at", where))


def _point(table: Mapping[str, object], key: str, where: str) -> tuple[float, float, float]:
    value = table.get(key)
    if (
        not isinstance(value, list)
        or len(numbers := cast("list[object]", value)) != 3
        or not all(
            type(n) in (int, float) and abs(cast("float", n)) <= MAX_COORDINATE for n in numbers
        )
    ):
        raise InputError(f"{where}: camera.{key} must be three numbers, [x, y, z], got {value!r}")
    x, y, z = (float(cast("float", number)) for number in numbers)
    return x, y, z
