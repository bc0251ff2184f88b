"""What a session begins with: a dataset that was opened, and perhaps a session that was saved.

A saved session is a file: dataset, pair, parameters, view, camera and decisions on pairs.
"""

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TypeAlias

import tomli_w
from msgspec import Struct

from app.viewer.session.decisions import MOST_DECISIONS, Decisions, read_decisions, tables_of
from app.viewer.session.methods import METHOD_NAMES, METHODS, MethodName
from app.viewer.session.state import (
    Camera,
    ViewOptions,
    ViewState,
    check_pair,
    open_dataset,
    with_method,
    with_pair,
    with_params,
)
from gpgrad_core.detection import PipelineParams
from gpgrad_core.errors import InputError
from gpgrad_core.params import to_tables, with_tables
from gpgrad_core.reading.paths import check_path
from gpgrad_core.reading.records import as_record, parse_toml
from gpgrad_core.reading.text import read_text
from gpgrad_core.simulation.demo import demo_path
from gpgrad_core.slam import Drive, Run
from gpgrad_core.types import Coordinate, Dataset

ENDING = ".gpgrad.toml"
LARGEST = 100_000
"""Bytes of such a file: a few thousand, and about 70 for each decision. What a page sends is parsed
in a thread of its own, which such a file keeps busy for a tenth of a second at most."""
Place: TypeAlias = tuple[Coordinate, Coordinate, Coordinate]
RULES = {
    "view": "a table, [view]",
    "params": "a table, [params]",
    "camera": "a table, [camera]",
    "position": "three numbers, [x, y, z]",
    "look_at": "three numbers, [x, y, z]",
    "method": " or ".join(METHOD_NAMES),
}
"""What values of the file must be, where their types do not say it in words."""


class _CameraTable(Struct):
    position: Place
    look_at: Place


class _SavedTable(Struct, forbid_unknown_fields=True):
    """The file as it is; what options, parameters and decisions may be is in types of their own."""

    dataset: str | None = None
    query: str | None = None
    database: str | None = None
    view: dict[str, object] = {}
    method: MethodName = "gradient"
    params: dict[str, object] = {}
    camera: _CameraTable | None = None
    decisions: list[object] = []


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
        ids = {submap.id for submap in dataset.submaps}
        for pair in self.decisions.pairs:
            for name in pair:
                if name not in ids:
                    dataset.submap(name)

    def apply(self, state: ViewState) -> ViewState:
        """Apply everything that was saved to a dataset that was just opened."""
        state = with_pair(state, query_id=self.query_id, database_id=self.database_id)
        state = with_params(with_method(state, self.method), self.params)
        return replace(state, options=self.options)


def session_text(
    state: ViewState, camera: Camera | None, decisions: Decisions | None = None
) -> str:
    """Write a session as TOML.

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
    """Parse the text of a saved session, TOML in UTF-8, which a message names as ``where``.

    Raises:
        InputError: As `read_session`.
    """
    return as_saved(parse_toml(text, where, LARGEST), where)


def as_saved(table: object, where: str) -> SavedSession:
    """Make a saved session of the tables of a file, or of what a link says.

    A message names it as ``where``.

    Raises:
        InputError: If a name is not known, or a value is none that it can be.
    """
    saved = as_record(table, _SavedTable, where, RULES)
    base = METHODS[saved.method].adapt(PipelineParams())
    return SavedSession(
        None if saved.dataset is None else _path(saved.dataset, where),
        saved.query,
        saved.database,
        with_tables(ViewOptions(), saved.view, f"{where}, [view]"),
        with_tables(base, saved.params, f"{where}, [params]"),
        None if saved.camera is None else Camera(saved.camera.position, saved.camera.look_at),
        read_decisions(saved.decisions, where),
        saved.method,
    )


def _path(text: str, where: str) -> Path:
    try:
        return check_path(text)
    except InputError as error:
        raise InputError(f"{where}: dataset: {error}") from None


@dataclass(frozen=True, eq=False)
class Opened:
    """A dataset that was read, and what to start it with.

    Attributes:
        dataset: The submaps.
        params: What "Reset parameters" goes back to, as it was given.
        source: Path that it was read from.
        saved: Pair, parameters and view to begin with; None begins as the dataset prefers.
        used: What `resolve_parameters` made of the parameters; None if it was not asked yet.
        drive: The drive that made the submaps, if it is known; it may still go on.
    """

    dataset: Dataset
    params: PipelineParams
    source: str
    saved: SavedSession | None = None
    used: PipelineParams | None = None
    drive: Drive | Run | None = None

    def begin(self, options: ViewOptions) -> ViewState:
        """Make the first snapshot; a saved session comes with its own options."""
        state = open_dataset(self.dataset, self.params, options, self.source, self.used)
        return state if self.saved is None else self.saved.apply(state)
