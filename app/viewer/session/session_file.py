"""What a session holds, as one value: dataset, pair, parameters, view, decisions and more.

It is written in three ways: as a TOML file, as the part of an address behind ``#``, and as commands
that find the same. The server of the page never sees that part of an address, and viser, which
reads words of its own behind ``?``, leaves it alone. Files and addresses come from outside: every
value is checked.
"""

import shlex
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any, TypeAlias
from urllib.parse import parse_qsl, quote

import msgspec
import tomli_w
from msgspec import Meta, Struct

from app.viewer.session.decisions import (
    MOST_DECISIONS,
    Decisions,
    DecisionTable,
    read_decisions,
    tables_of,
)
from app.viewer.session.methods import METHOD_NAMES, METHODS, MethodName
from app.viewer.session.state import (
    Camera,
    Setting,
    Subject,
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
from gpgrad_core.params import (
    changes,
    flag_of,
    parameters_of,
    preferred_parameters,
    to_tables,
    value_text,
    with_tables,
)
from gpgrad_core.reading.paths import check_path
from gpgrad_core.reading.records import Finite, as_builtins, as_record, parse_toml
from gpgrad_core.reading.text import read_text
from gpgrad_core.simulation.demo import demo_path
from gpgrad_core.slam import Drive, Run
from gpgrad_core.types import Coordinate, Dataset

ENDING = ".gpgrad.toml"
LARGEST = 100_000
"""Bytes of such a file: a few thousand, and about 70 for each decision. What a page sends is parsed
in a thread of its own, which such a file keeps busy for a tenth of a second at most."""
LONGEST = 3500
"""Characters of such a part of an address; what tells it to the server takes little more."""
MOST_ENTRIES = 200
LINK = "the link"
PERSONAL = ("dark",)
"""Options of the view that are the reader's own."""
Place: TypeAlias = tuple[Coordinate, Coordinate, Coordinate]
CameraNumbers: TypeAlias = tuple[
    Coordinate, Coordinate, Coordinate, Coordinate, Coordinate, Coordinate
]
MOST_KEYFRAMES, MOST_LETTERS = 50, 200
"""Of a session's file, and of the words of each."""
Words: TypeAlias = Annotated[str, Meta(max_length=MOST_LETTERS)]
Whole: TypeAlias = Annotated[int, Meta(ge=-(2**53), le=2**53)]
RULES = {
    "view": "a table, [view]",
    "params": "a table, [params]",
    "reference": "a table, [reference]",
    "camera": "a table, [camera]",
    "position": "three numbers, [x, y, z]",
    "look_at": "three numbers, [x, y, z]",
    "method": " or ".join(METHOD_NAMES),
    "scene": "pair or world",
}
"""What values of the file must be, where their types do not say it in words."""


WORDS = ("dataset", "query", "database", "scene", "method")
"""Of an address, as they stand in a file; others are taken apart first."""
GROUPS: dict[str, dict[str, type | tuple[str, ...]]] = {
    group: {setting.path: setting.kind for setting in parameters_of(kind)}
    for group, kind in (("view", ViewOptions), ("params", PipelineParams))
}
GROUPS["reference"] = {
    "method": METHOD_NAMES,
    **{f"params.{path}": kind for path, kind in GROUPS["params"].items()},
}
"""By the word before its point, what an address sets, each with its kind."""


@dataclass(frozen=True)
class Keyframe:
    """A step of a demonstration; its motion follows from the step before."""

    title: str  # what the step shows, in a few words
    line: str = ""  # the figures of it
    options: ViewOptions = field(default_factory=ViewOptions)
    camera: Camera | None = None  # None frames what is shown
    subject: Subject = "pair"


class _CameraTable(Struct):
    position: Place
    look_at: Place

    @property
    def camera(self) -> Camera:
        return Camera(self.position, self.look_at)


class _KeyframeTable(Struct, omit_defaults=True, forbid_unknown_fields=True):
    title: Words
    line: Words = ""
    scene: Subject = "pair"
    view: dict[str, object] = {}
    camera: _CameraTable | None = None


class _SettingTable(Struct, forbid_unknown_fields=True):
    method: MethodName = "gradient"
    params: dict[str, object] = {}


class _SavedTable(Struct, forbid_unknown_fields=True):
    """The file as it is; what options and parameters may be is in types of their own."""

    dataset: str | None = None
    query: str | None = None
    database: str | None = None
    scene: Subject = "pair"
    method: MethodName = "gradient"
    view: dict[str, object] = {}
    params: dict[str, object] = {}
    reference: _SettingTable | None = None
    camera: _CameraTable | None = None
    decisions: list[DecisionTable] = []
    keyframes: Annotated[list[_KeyframeTable], Meta(max_length=MOST_KEYFRAMES)] = []


@dataclass(frozen=True, eq=False)
class SavedSession:
    """What a session holds, without the data."""

    dataset: Path | None = None  # None is the built-in demo
    query_id: str | None = None  # None where nothing says it
    database_id: str | None = None
    options: ViewOptions = field(default_factory=ViewOptions)
    params: PipelineParams = field(default_factory=PipelineParams)  # of the method
    camera: Camera | None = None  # of a page
    decisions: Decisions = field(default_factory=Decisions)
    method: MethodName = "gradient"
    subject: Subject = "pair"  # what the scene shows
    reference: Setting | None = None  # A, beside which the others are shown
    keyframes: tuple[Keyframe, ...] = ()  # of a demonstration; without any, the story of the pair

    @classmethod
    def of(
        cls,
        state: ViewState,
        camera: Camera | None = None,
        decisions: Decisions | None = None,
        subject: Subject = "pair",
        keyframes: tuple[Keyframe, ...] = (),
    ) -> "SavedSession":
        source = Path(state.source)
        return cls(
            None if source == demo_path() else source.absolute(),
            state.query_id,
            state.database_id if state.is_pair else None,
            state.options,
            state.asked,
            camera,
            decisions or Decisions(),
            state.method,
            subject,
            state.reference,
            keyframes,
        )

    @property
    def words(self) -> dict[str, str]:
        """What files and addresses say in a word; what is gpgrad's own choice is left out."""
        named = {
            "dataset": self.dataset,
            "query": self.query_id,
            "database": self.database_id,
            "scene": None if self.subject == SavedSession.subject else self.subject,
            "method": None if self.method == SavedSession.method else self.method,
        }
        return {word: str(value) for word, value in named.items() if value is not None}

    def check(self, dataset: Dataset) -> None:
        """Raise an InputError if a dataset lacks the pair, or one of those that were decided."""
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
        state = with_pair(state, query_id=self.query_id, database_id=self.database_id)
        state = with_params(with_method(state, self.method), self.params)
        return replace(state, options=self.options, reference=self.reference)


# As a file.


def session_text(
    state: ViewState,
    camera: Camera | None,
    decisions: Decisions | None = None,
    keyframes: tuple[Keyframe, ...] = (),
) -> str:
    """Write a session as TOML; more decisions than such a file takes are an InputError."""
    saved = SavedSession.of(state, camera, decisions, keyframes=keyframes)
    table: dict[str, object] = {**saved.words, "view": to_tables(saved.options)}
    if camera is not None:
        camera = camera.with_perspective
        table["camera"] = {"position": camera.position, "look_at": camera.look_at}
    table["params"] = to_tables(saved.params)
    if saved.reference is not None:
        method, params = saved.reference
        table["reference"] = {"method": method, "params": to_tables(params)}
    decided = tables_of(saved.decisions)
    if decided:
        table["decisions"] = decided
    if keyframes:
        table["keyframes"] = [_table_of(frame) for frame in keyframes]
    text = f"# gpgrad view --state FILE\n{tomli_w.dumps(table)}"
    if len(text.encode()) > LARGEST or len(decided) > MOST_DECISIONS:
        raise InputError(
            f"a session file has no room for {len(decided):,} decisions; export closures.json, "
            "which keeps them all"
        )
    return text


def _table_of(frame: Keyframe) -> dict[str, Any]:
    camera = frame.camera and _CameraTable(frame.camera.position, frame.camera.look_at)
    view = to_tables(frame.options)
    return as_builtins(_KeyframeTable(frame.title, frame.line, frame.subject, view, camera))


def read_session(path: Path) -> SavedSession:
    """Read a session from a file."""
    try:
        text = read_text(path, LARGEST)
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from error
    return parse_session(text, str(path))


def parse_session(text: str | bytes, where: str) -> SavedSession:
    """Parse the text of a saved session, TOML in UTF-8, which a message names as ``where``."""
    return _saved_of(parse_toml(text, where, LARGEST), where)


def _saved_of(table: object, where: str) -> SavedSession:
    saved = as_record(table, _SavedTable, where, RULES)
    reference, params = saved.reference, _setting_of(saved.method, saved.params, where).params
    return SavedSession(
        None if saved.dataset is None else _path(saved.dataset, where),
        saved.query,
        saved.database,
        with_tables(ViewOptions(), saved.view, f"{where}, [view]"),
        params,
        saved.camera and saved.camera.camera,
        read_decisions(saved.decisions, where),
        saved.method,
        saved.scene,
        None if reference is None else _setting_of(reference.method, reference.params, where),
        tuple(
            Keyframe(
                row.title,
                row.line,
                with_tables(ViewOptions(), row.view, f"{where}, keyframes[{k}], view"),
                row.camera and row.camera.camera,
                row.scene,
            )
            for k, row in enumerate(saved.keyframes)
        ),
    )


def _setting_of(method: MethodName, tables: Mapping[str, object], where: str) -> Setting:
    base = METHODS[method].adapt(PipelineParams())
    return Setting(method, with_tables(base, tables, f"{where}, [params]"))


def _path(text: str, where: str) -> Path:
    try:
        return check_path(text)
    except InputError as error:
        raise InputError(f"{where}: dataset: {error}") from None


# As an address.


def address_of(state: ViewState, subject: Subject = "pair", camera: Camera | None = None) -> str:
    """Write what is shown; nothing if the dataset has no path, or it would be too long.

    All parameters are named that are not the method's own. What is automatic is fitted where the
    link is opened, and gives the same numbers there, because it depends on the dataset alone.
    Without a camera the reader's page chooses.
    """
    if not state.source:
        return ""
    saved = SavedSession.of(state, subject=subject)
    entries = saved.words
    groups: list[tuple[str, object, object]] = [
        ("view", saved.options, ViewOptions()),
        ("params", saved.params, METHODS[saved.method].adapt(PipelineParams())),
    ]
    if saved.reference is not None:
        method, params = saved.reference
        entries["reference.method"] = method
        groups.append(("reference.params", params, METHODS[method].adapt(PipelineParams())))
    for group, values, base in groups:
        for setting, value in changes(values, base):
            if setting.path not in PERSONAL:
                entries[f"{group}.{setting.path}"] = value_text(value)
    if camera is not None:
        camera = camera.with_perspective
        # Rounded, and never -0: what a camera's turns leave of a zero is no place.
        numbers = (round(float(number), 4) + 0.0 for number in (*camera.position, *camera.look_at))
        entries["camera"] = ",".join(f"{number:.4g}" for number in numbers)
    text = "&".join(f"{key}={quote(value, safe='/:,.')}" for key, value in entries.items())
    return text if len(text) <= LONGEST else ""


def read_address(text: str, options: ViewOptions | None = None) -> SavedSession:
    """Read what is behind ``#``; the options of the view give what is the reader's own."""
    if len(text) > LONGEST:
        raise InputError(f"{LINK}: may have {LONGEST:,} characters, got {len(text):,}")
    try:
        pairs = parse_qsl(
            text, keep_blank_values=True, strict_parsing=True, max_num_fields=MOST_ENTRIES
        )
    except ValueError as error:
        raise InputError(f"{LINK}: is not made of name=value, joined by &") from error
    given = dict(pairs)
    if len(given) < len(pairs):
        raise InputError(f"{LINK}: says the same thing twice")
    table: dict[str, Any] = {}
    for key, value in given.items():
        group, _, path = key.partition(".")
        if key == "camera":
            table[key] = _camera(value)
        elif key in WORDS:
            table[key] = value
        elif not path or group not in GROUPS:
            raise InputError(f"{LINK}: unknown word {key[:40]!r}")
        elif path not in GROUPS[group]:
            raise InputError(f"{LINK}: unknown parameter {path[:60]!r}")
        else:
            inner = table
            *groups, name = key.split(".")
            for part in groups:
                inner = inner.setdefault(part, {})
            inner[name] = _value(value, GROUPS[group][path])
    saved = _saved_of(table, LINK)
    own = {name: getattr(options or ViewOptions(), name) for name in PERSONAL}
    return replace(saved, options=replace(saved.options, **own))


def _value(text: str, kind: object) -> object:
    """Read a truth value or a number, as the parameter has it; what is none is a text."""
    for one in (bool,) if kind is bool else (Whole, Finite):
        with suppress(msgspec.ValidationError):
            return msgspec.convert(text, one, strict=False)
    return text


def _camera(text: str) -> dict[str, tuple[float, ...]]:
    """Read six numbers: where a camera stands, and what it looks at."""
    try:
        numbers = msgspec.convert(text.split(","), CameraNumbers, strict=False)
    except msgspec.ValidationError:
        rule = "camera must be six numbers that are places"
        raise InputError(f"{LINK}: {rule}, got {text[:40]!r}") from None
    if numbers[:3] == numbers[3:]:
        raise InputError(f"{LINK}: camera cannot be at {text[:60]}")
    return {"position": numbers[:3], "look_at": numbers[3:]}


# As commands.


def detect_command(state: ViewState, *, alone: bool = True) -> str:
    """Write the ``gpgrad detect`` command that gives exactly the numbers shown.

    Only what differs from what the dataset takes by itself is named. A pair that was judged alone
    is named too: the other way round it would be another registration, and all other pairs would
    take their time.
    """
    words = ["gpgrad", "detect", str(Path(state.source).absolute()), "--out", "closures.json"]
    words += ["--pair", state.query_id, state.database_id] if alone else []
    if state.method != SavedSession.method:
        words += ["--method", state.method]
    base = METHODS[state.method].adapt(preferred_parameters(state.dataset, PipelineParams()))
    for setting, value in changes(state.asked, base):
        words += flag_of(setting.path, value)
    return shlex.join(words)


def page_commands(state: ViewState, *, decided: bool = False) -> list[str]:
    """Write the commands that make the page of the dataset, but for closures that are exported."""
    if not state.source:
        return []
    has_truth = len(state.dataset.true_poses) >= 2
    words = ["gpgrad", "evaluate" if has_truth else "slam", str(Path(state.source).absolute())]
    words += ["--closures", "closures.json", "--out", "page"]
    return [*([] if decided else [detect_command(state, alone=False)]), shlex.join(words)]


@dataclass(frozen=True, eq=False)
class Opened:
    """A dataset that was read, and what to start it with."""

    dataset: Dataset
    params: PipelineParams  # what "Reset parameters" restores, as it was requested
    source: str  # path that it was read from
    saved: SavedSession | None = None  # None begins as the dataset prefers
    used: PipelineParams | None = None  # the parameters resolved; None if they are not yet
    drive: Drive | Run | None = None  # that the submaps are from, if any; it may still go on
    subject: Subject = "pair"  # what the scene shows first, where nothing is saved

    def begin(self, options: ViewOptions) -> ViewState:
        """Make the first snapshot; a saved session comes with its own options."""
        state = open_dataset(self.dataset, self.params, options, self.source, self.used)
        return state if self.saved is None else self.saved.apply(state)
