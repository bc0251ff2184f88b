"""``run.gpgrad``: the record of a drive, which grows with every submap and every moment.

The guide has the format (commands.md). An entry is on the disk when its method returns,
and the next writer goes on behind the last whole entry.
"""

import contextlib
import errno
import math
import os
import struct
import zlib
from collections.abc import Iterator
from dataclasses import astuple, dataclass, field, is_dataclass, replace
from pathlib import Path
from types import TracebackType
from typing import IO, Annotated, Any, TypeAlias

import msgspec
import numpy as np
from jaxtyping import Float
from msgspec import Meta, Struct, structs

from gpgrad_core import __version__
from gpgrad_core.detection import PipelineParams
from gpgrad_core.detection.shortlist import Candidate, Candidates, check_candidates
from gpgrad_core.errors import InputError
from gpgrad_core.io.records.closures import closure_of, values_of
from gpgrad_core.io.records.files import check_output
from gpgrad_core.params import to_tables, with_tables
from gpgrad_core.reading.files import open_regular
from gpgrad_core.reading.records import Count, Finite, NotNegative
from gpgrad_core.run.folders import NameLock, naming
from gpgrad_core.se2 import Pose
from gpgrad_core.slam.graph import GraphParams
from gpgrad_core.slam.loop_closer import Moment
from gpgrad_core.slam.optimise import SolverParams
from gpgrad_core.types import (
    Array,
    Associations,
    Coordinate,
    Dataset,
    ImageSays,
    LoopClosure,
    Submap,
    check_coordinates,
)

MAGIC = b"gpgrad run 1\n"
HEAD = struct.Struct("<II")
LARGEST_ENTRY = 1_000_000_000
"""Bytes; a submap of 30 million points has as many."""
LONGEST_TEXT = 10_000
ENDING = ".gpgrad"

Text: TypeAlias = Annotated[str, Meta(max_length=LONGEST_TEXT)]
BoundedRow: TypeAlias = tuple[Coordinate, Coordinate, Coordinate, Finite, Finite, Finite, Finite]


@dataclass(frozen=True)
class RunSettings:
    """What a drive was made with."""

    name: str = "drive"  # the name that people see
    params: PipelineParams = field(default_factory=PipelineParams)
    graph: GraphParams = field(default_factory=GraphParams)
    solver: SolverParams = field(default_factory=SolverParams)
    candidates: Candidates = "automatic"
    search_radius: float | None = None
    incremental: bool = False  # whether each solution started from the one before


@dataclass(frozen=True, eq=False)
class Run:
    """The content of a record.

    Attributes:
        settings: What the drive was made with.
        submaps: All submaps of the record, in their order. Only the first ones have a moment, if
            the writer was stopped.
        starts: Ids of the submaps that begin another traverse.
        moments: The moments of the first submaps, one for each; the last one as it was settled.
        settled: Whether the drive was settled after the last moment.
        notes: What is not whole about the file, one line each. Show them to the user.
    """

    settings: RunSettings
    submaps: tuple[Submap, ...]
    starts: frozenset[str]
    moments: tuple[Moment, ...]
    notes: tuple[str, ...] = ()
    settled: bool = False

    @property
    def dataset(self) -> Dataset:
        """The submaps as a dataset."""
        preferred = to_tables(self.settings.params)
        return Dataset(self.settings.name, self.submaps, preferred=preferred, notes=self.notes)


class _Settings(Struct, tag="settings"):
    gpgrad: Text
    name: Text
    params: dict[str, object]
    graph: dict[str, object]
    solver: dict[str, object]
    candidates: int | str
    search_radius: NotNegative | None
    incremental: bool = False


class _Values(Struct):
    """Numbers in rows; those that are all single ones take half the room."""

    single: bool
    columns: Annotated[int, Meta(ge=1, le=7)]
    values: bytes

    @classmethod
    def of(cls, rows: Float[Array, "..."]) -> "_Values":
        short = rows.astype(np.float32)
        single = bool(np.array_equal(short, rows))
        columns = rows.shape[1] if rows.ndim == 2 else 1
        values = short.astype("<f4") if single else rows.astype("<f8")
        return cls(single, columns, values.tobytes())

    def rows(self, columns: int, where: str) -> Array:
        """The rows (n, columns), or (n,) of one column."""
        size = (4 if self.single else 8) * columns
        if self.columns != columns or len(self.values) % size:
            raise InputError(f"{where}: a list of numbers is not whole")
        kind = "<f4" if self.single else "<f8"
        with np.errstate(invalid="ignore"):  # what is not finite is refused later
            numbers = np.frombuffer(self.values, kind).astype(np.float64)
        return numbers.reshape(-1, columns) if columns > 1 else numbers


class _SubmapEntry(Struct, tag="submap"):
    id: Text
    points: _Values
    starts_traverse: bool
    pose_odometry: BoundedRow
    pose_true: BoundedRow | None = None
    num_dropped: Count = 0
    num_outliers: Count = msgspec.field(default=0, name="num_wild")
    num_non_ground: Count = msgspec.field(default=0, name="num_standing")
    left_out: _Values | None = None
    colors: _Values | None = None
    noise_std: _Values | None = None
    ranges: _Values | None = None

    @classmethod
    def of(cls, submap: Submap, starts_traverse: bool) -> "_SubmapEntry":
        values: dict[str, Any] = {
            name: getattr(submap, name, None) for name in cls.__struct_fields__
        }
        values["starts_traverse"] = starts_traverse
        for name, value in values.items():
            if isinstance(value, np.ndarray):
                values[name] = _Values.of(value)
            elif isinstance(value, Pose):
                values[name] = value.row
        return cls(**values)

    def submap(self, where: str) -> Submap:
        def rows_of(values: _Values | None, columns: int) -> Array | None:
            return None if values is None else values.rows(columns, where)

        bare = Submap(
            f"{where}, submap {self.id!a}",  # so that errors name it
            np.empty((0, 3)),
            "",
            pose_true=_pose(self.pose_true, where) if self.pose_true else None,
            pose_odometry=_pose(self.pose_odometry, where),
            num_dropped=self.num_dropped,
            num_outliers=self.num_outliers,
            num_non_ground=self.num_non_ground,
            left_out=rows_of(self.left_out, 3),
        )
        points = self.points.rows(3, where)
        rest = rows_of(self.colors, 3), rows_of(self.noise_std, 1), rows_of(self.ranges, 1)
        for values in (points, *rest):
            if values is not None and not np.isfinite(values).all():
                raise InputError(f"{bare.id}: a value of a point is not finite")
            if values is not None and len(values) != len(points):
                raise InputError(
                    f"{bare.id}: has {len(points):,} points and values for {len(values):,}"
                )
        check_coordinates(points, bare.id)
        return replace(bare.refilled(points, *rest), id=self.id)


class _Inliers(Struct):
    count: Associations
    bits: bytes


class _Context(Struct, array_like=True):
    own_score: NotNegative
    score: NotNegative
    misfit: NotNegative
    support: Finite
    places: Count
    variance_factor: NotNegative = 1.0  # older files have none


class _Pair(Struct, omit_defaults=True):
    """A closure with all of its digits, its parts as lists; `Registration` explains the names."""

    query: Text
    database: Text
    accepted: bool
    reason: Text
    inliers: _Inliers
    overlap_area: NotNegative
    correlation: Finite
    score: Finite
    T_database_query: tuple[Coordinate, Coordinate, Finite] | None = msgspec.field(
        default=None, name="motion"
    )
    dissimilarity: NotNegative | None = None
    z_offset: Finite = 0.0
    covariance: tuple[tuple[Finite, Finite, Finite], ...] | None = None
    z_std: NotNegative | None = None
    scale: NotNegative | None = None
    agreement: tuple[NotNegative, NotNegative, NotNegative] | None = None
    nothing_trusted: bool = False
    evidence: Annotated[tuple[Finite, ...], Meta(max_length=1000)] = ()
    mean_dissimilarity: NotNegative | None = None
    images: tuple[ImageSays, Text, Count, Count] | None = None
    context: _Context | None = None
    undecided: bool = False
    overlap_middle: tuple[Coordinate, Coordinate] | None = None

    @classmethod
    def of(cls, closure: LoopClosure) -> "_Pair":
        inliers = closure.registration.inliers
        values = values_of(closure)
        values["inliers"] = _Inliers(len(inliers), np.packbits(inliers).tobytes())
        return cls(**{name: _compact(values[name]) for name in cls.__struct_fields__})

    def closure(self, where: str) -> LoopClosure:
        count, covariance = self.inliers.count, self.covariance
        bits = np.unpackbits(np.frombuffer(self.inliers.bits, np.uint8))
        if not 0 <= len(bits) - count < 8:
            raise InputError(f"{where}: the inliers of a pair are broken")
        if covariance is not None and len(covariance) != 3:
            raise InputError(f"{where}: a covariance must be 3 x 3")
        values = structs.asdict(self)
        values |= {"inliers": bits[:count].astype(np.bool_)}
        values |= {"covariance": None if covariance is None else np.array(covariance)}
        values |= {"context": self.context and structs.astuple(self.context)}
        return closure_of(values)


class _Moment(Struct, tag="moment"):
    submap: Text
    pairs: list[_Pair]
    shortlist: list[tuple[Text, Count, Finite]] | None
    flipped: list[_Pair] = msgspec.field(name="turned")
    rejected: list[tuple[Text, Text]] = msgspec.field(name="left_out")
    places: bytes
    covariances: bytes
    moved: NotNegative

    @classmethod
    def of(cls, moment: Moment) -> "_Moment":
        chosen = moment.shortlist
        return cls(
            pairs=[_Pair.of(closure) for closure in moment.closures],
            shortlist=None
            if chosen is None
            else [(one.id, one.votes, one.similarity) for one in chosen],
            flipped=[_Pair.of(closure) for closure in moment.flipped],
            **_solution_of(moment),
        )

    def moment(
        self, odometry: Pose, starts_traverse: bool, ids: tuple[str, ...], where: str
    ) -> Moment:
        present = set(ids)
        for pair in (*self.pairs, *self.flipped):
            if not {pair.query, pair.database} <= present:
                raise InputError(f"{where}: names a submap that did not come before")
        return Moment(
            tuple(pair.closure(where) for pair in self.pairs),
            None if self.shortlist is None else tuple(Candidate(*one) for one in self.shortlist),
            ids,
            odometry=odometry,
            starts_traverse=starts_traverse,
            flipped=tuple(pair.closure(where) for pair in self.flipped),
            **_solution(self, len(ids), where),
        )


class _Settled(Struct, tag="settled"):
    """What takes the place of the last moment's own, as long as that is the last."""

    submap: Text
    rejected: list[tuple[Text, Text]] = msgspec.field(name="left_out")
    places: bytes
    covariances: bytes
    moved: NotNegative


def _solution_of(moment: Moment) -> dict[str, Any]:
    return {
        "submap": moment.submap_id,
        "rejected": list(moment.rejected),
        "places": moment.places.astype("<f8").tobytes(),
        "covariances": moment.covariances.astype("<f8").tobytes(),
        "moved": moment.moved,
    }


def _solution(entry: _Moment | _Settled, count: int, where: str) -> dict[str, Any]:
    return {
        "rejected": tuple(entry.rejected),
        "places": _matrix(entry.places, count, (7,), where),
        "covariances": _matrix(entry.covariances, count, (3, 3), where),
        "moved": entry.moved,
    }


_Entry: TypeAlias = _Settings | _SubmapEntry | _Moment | _Settled
_ENCODER, _DECODER = msgspec.msgpack.Encoder(), msgspec.msgpack.Decoder(_Entry)


def _lock(path: Path) -> NameLock:
    """Lock a file, which is made if there is none."""
    if path.exists() and not path.is_file():
        raise InputError(f"{path}: is no regular file; name another one")
    path.touch()
    return NameLock(path)


class RunWriter:
    """Writes a record, entry by entry; each is on the disk when its method returns.

    It locks the file, because two writers would overwrite each other's entries.
    """

    def __init__(
        self, path: Path | str, settings: RunSettings | None = None, *, is_locked: bool = False
    ) -> None:
        """Begin a record; a file of that name is replaced.

        Args:
            path: The file.
            settings: What the drive was made with.
            is_locked: Whether the caller has locked the file against other writers.

        Raises:
            InputError: If it cannot be a file, or if another writer has it.
            OSError: If it cannot be written.
        """
        self.path = Path(path)
        self._lock = None if is_locked else _lock(check_output(path))
        self._submap_ids: set[str] = set()
        self._moment_ids: set[str] = set()
        self._settled = ""  # id of the submap whose moment was settled last
        values: dict[str, Any] = {**vars(settings or RunSettings())}
        values |= {name: to_tables(values[name]) for name in ("params", "graph", "solver")}
        entry = _Settings(__version__, **values)
        try:
            self._file = self.path.open("wb", buffering=0)
        except BaseException:
            self._release()
            raise
        try:
            self._file.write(MAGIC)
            self._write(entry)
        except BaseException:
            self.close()
            raise

    @classmethod
    def resume(cls, path: Path | str, *, is_locked: bool = False) -> tuple["RunWriter", Run]:
        """Continue a record behind its last whole entry; also return its content.

        Raises:
            InputError: As `read_run`, or if another writer has it.
            OSError: If it cannot be read or written.
        """
        path = Path(path)
        writer = cls.__new__(cls)
        writer.path, writer._lock = path, None
        try:
            if path.exists() and not is_locked:
                writer._lock = _lock(path)  # before it is read: nobody may write more meanwhile
            run, end = _read(path)
            writer._file = path.open("r+b", buffering=0)
        except BaseException:
            writer._release()
            raise
        writer._file.truncate(end)
        writer._file.seek(end)
        writer._submap_ids = {submap.id for submap in run.submaps}
        writer._moment_ids = {moment.submap_id for moment in run.moments}
        writer._settled = run.moments[-1].submap_id if run.settled else ""
        return writer, run

    def __enter__(self) -> "RunWriter":
        return self

    def __exit__(
        self, _: type[BaseException] | None, __: BaseException | None, ___: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        self._file.close()
        self._release()

    def _release(self) -> None:
        if self._lock is not None:
            self._lock.release()

    def keep(self, submap: Submap, *, starts_traverse: bool = False) -> None:
        """Add a submap, unless the record has it.

        Raises:
            InputError: If it has no odometry pose.
            OSError: If the disk is full.
        """
        if submap.id in self._submap_ids:
            return
        if submap.pose_odometry is None:
            raise InputError(f"submap {submap.id} has no odometry pose, which a drive needs")
        self._write(_SubmapEntry.of(submap, starts_traverse))
        self._submap_ids.add(submap.id)

    def add(self, moment: Moment) -> None:
        """Add the moment of a submap of the record, unless the record has it.

        Raises:
            OSError: If the disk is full.
        """
        if moment.submap_id not in self._moment_ids:
            self._write(_Moment.of(moment))
            self._moment_ids.add(moment.submap_id)

    def settle(self, moment: Moment) -> None:
        """Add what takes the place of the last moment, unless the record has it.

        Raises:
            OSError: If the disk is full.
        """
        if moment.submap_id != self._settled:
            self._write(_Settled(**_solution_of(moment)))
            self._settled = moment.submap_id

    def _write(self, entry: _Entry) -> None:
        content, end = _ENCODER.encode(entry), self._file.tell()
        rest = memoryview(HEAD.pack(len(content), zlib.crc32(content)) + content)
        try:
            self._check_there()
            with naming(self.path):
                while rest:
                    rest = rest[self._file.write(rest) :]
                os.fsync(self._file.fileno())
            self._check_there()  # nobody finds what is written to a file without a name
        except OSError:  # what comes later must not follow half an entry, nor find this one there
            with contextlib.suppress(OSError):
                self._file.truncate(end)
            self._file.seek(end)
            raise

    def _check_there(self) -> None:
        with contextlib.suppress(FileNotFoundError):
            if os.path.samestat(os.fstat(self._file.fileno()), self.path.stat()):
                return
        raise OSError(errno.ESTALE, "it was removed or replaced", str(self.path))


def read_run(path: Path | str) -> Run:
    """Read a record, up to its last whole entry.

    Raises:
        InputError: If it is not a record, or an entry contradicts the ones before it.
        OSError: If it cannot be read.
    """
    return _read(Path(path))[0]


def is_run(path: Path | str) -> bool:
    """Whether a file is a record, by its first bytes; see `open_regular`."""
    with open_regular(Path(path)) as file:
        return file.read(len(MAGIC)) == MAGIC


def _read(path: Path) -> tuple[Run, int]:
    """Read a record; also gives where its last whole entry ends."""
    settings: RunSettings | None = None
    submaps, starts = dict[str, Submap](), set[str]()
    waiting: dict[str, Pose] = {}  # odometry of the submaps without a moment
    ids: tuple[str, ...] = ()
    moments: list[Moment] = []
    final: Moment | None = None
    notes: list[str] = []
    end = 0
    with open_regular(path) as file:
        for entry, stop, where in _entries(file, path, notes):
            end = stop
            if isinstance(entry, _Settings):
                if settings is not None:
                    raise InputError(f"{where}: has the settings a second time")
                settings = _settings(entry, where)
            elif settings is None:
                raise InputError(f"{where}: must begin with the settings")
            elif isinstance(entry, _SubmapEntry):
                if entry.id in submaps:
                    raise InputError(f"{where}: has submap {entry.id!r} a second time")
                submaps[entry.id] = entry.submap(where)
                starts |= {entry.id} if entry.starts_traverse else set()
                waiting[entry.id] = _pose(entry.pose_odometry, where)
            elif isinstance(entry, _Settled):
                if not ids or entry.submap != ids[-1]:
                    raise InputError(
                        f"{where}: settles submap {entry.submap!r}, which is not the last"
                    )
                final = replace(moments[-1], **_solution(entry, len(ids), where))
            else:
                final = None
                odometry = waiting.pop(entry.submap, None)
                if odometry is None:
                    raise InputError(f"{where}: has no submap {entry.submap!r} before its moment")
                ids += (entry.submap,)
                moments.append(entry.moment(odometry, entry.submap in starts, ids, where))
    if settings is None:
        raise InputError(f"{path}: is not whole; it ends before its settings")
    order = [*ids, *waiting]
    run = Run(
        settings,
        tuple(submaps[name] for name in order),
        frozenset(starts),
        tuple(moments) if final is None else (*moments[:-1], final),
        tuple(notes),
        final is not None,
    )
    return run, end


def _entries(file: IO[bytes], path: Path, notes: list[str]) -> Iterator[tuple[_Entry, int, str]]:
    """Read the whole entries, each with where it ends, and note what follows them."""
    if file.read(len(MAGIC)) != MAGIC:
        raise InputError(f"{path}: is not a record of a drive, as gpgrad slam --record writes it")
    end, count = len(MAGIC), 0
    while head := file.read(HEAD.size):
        size, check = HEAD.unpack(head) if len(head) == HEAD.size else (0, 0)
        if size > LARGEST_ENTRY:
            size = 0
        content = file.read(size)
        if size == 0 or len(content) < size or zlib.crc32(content) != check:
            left = path.stat().st_size - end
            notes.append(
                f"{path}: is not whole: the last {left:,} bytes, from byte {end:,} on, are left "
                "out, because the writer was stopped there or the file is damaged"
            )
            return
        count, end = count + 1, end + HEAD.size + size
        where = f"{path}, entry {count}"
        try:
            entry = _DECODER.decode(content)
        except (msgspec.MsgspecError, ValueError, TypeError, RecursionError) as error:
            raise InputError(f"{where}: {error}") from None
        yield entry, end, where


def _settings(entry: _Settings, where: str) -> RunSettings:
    candidates: Candidates = "all"
    if isinstance(entry.candidates, int):
        candidates = check_candidates(entry.candidates, where)
    elif entry.candidates == "automatic":
        candidates = "automatic"
    elif entry.candidates != "all":
        raise InputError(f"{where}: 'candidates' must be a whole number, all or automatic")
    return RunSettings(
        entry.name,
        with_tables(PipelineParams(), entry.params, where),
        with_tables(GraphParams(), entry.graph, where),
        with_tables(SolverParams(), entry.solver, where),
        candidates,
        entry.search_radius,
        entry.incremental,
    )


def _matrix(values: bytes, count: int, shape: tuple[int, ...], where: str) -> Array:
    rows = np.frombuffer(values, "<f8").astype(np.float64) if len(values) % 8 == 0 else None
    if rows is None or rows.size != count * math.prod(shape) or not np.isfinite(rows).all():
        raise InputError(f"{where}: has not one row of finite numbers for each of {count} submaps")
    return rows.reshape(count, *shape)


def _pose(row: BoundedRow, where: str) -> Pose:
    if not abs(math.hypot(*row[3:]) - 1) < 1e-6:
        raise InputError(f"{where}: a quaternion has not the length 1")
    return Pose.of_row(row)


def _compact(value: Any) -> Any:
    """Write numbers as msgpack's own, and what is made of several as a list of them."""
    if isinstance(value, np.ndarray | np.generic):
        return _compact(value.tolist())
    if isinstance(value, tuple | list):
        return tuple(map(_compact, value))
    if is_dataclass(value) and not isinstance(value, type):
        return _compact(astuple(value))
    return value
