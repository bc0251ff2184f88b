"""``closures.json``, the verdict on every compared pair of submaps, and ``closures.csv``."""

import csv
import json
import math
import shutil
import tempfile
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import asdict, astuple, dataclass, field, fields, is_dataclass, replace
from pathlib import Path
from typing import Annotated, Any, TypeAlias, get_args

import cv2
import numpy as np
from jaxtyping import Float
from msgspec import Meta, Struct, structs

from gpgrad_core import __version__
from gpgrad_core.detection import DetectionResult, PipelineParams
from gpgrad_core.errors import InputError
from gpgrad_core.gp.likelihood import Hyperparameters
from gpgrad_core.io.records.files import check_output, replacing
from gpgrad_core.reading.records import (
    Count,
    Finite,
    NotNegative,
    as_builtins,
    as_record,
    read_json,
    shown,
)
from gpgrad_core.run.folders import naming
from gpgrad_core.se2 import FAR, SE2
from gpgrad_core.types import (
    MAX_COORDINATE,
    Agreement,
    Array,
    Associations,
    Context,
    Coordinate,
    Dataset,
    ImageSays,
    ImageVerdict,
    LoopClosure,
    Registration,
    SubmapSource,
)

MOST_PAIRS = 10**15
"""Of a dataset; a hundred times as many submaps as anybody has."""
MAX_YAW = 1e6
"""Of a motion [rad]; from there on an angle has lost ten of its digits."""
MAX_COVARIANCE = MAX_COORDINATE**2
"""[m²]"""
LONGEST_NOTE = 200
"""Letters of a note on a pair."""
Covariance: TypeAlias = Annotated[float, Meta(ge=-MAX_COVARIANCE, le=MAX_COVARIANCE)]
CovarianceRow: TypeAlias = tuple[Covariance, Covariance, Covariance]
RULES = {
    "covariance": "three rows of three finite numbers (a covariance must be 3 x 3)",
    "verdict": f"one of {', '.join(get_args(ImageSays))}",
}
"""What values of the file must be, where their types do not say it in words."""
PARTS = {
    "T_database_query": SE2,
    "agreement": Agreement,
    "images": ImageVerdict,
    "context": Context,
}
"""The parts of a closure, which some files have as lists of their values."""
UNKNOWN = {"T_database_query": None, "dissimilarity": math.inf, "correlation": 0.0}
"""What a registration has in place of values that a file does not have."""
LEFT_OUT = ("overlap_middle", "decision", "images", "mean_dissimilarity", "context")
"""What a row lacks where it is not known; everything else is null there."""
AS_THEY_ARE = ("dataset", "method", "seed", "params", "versions", "seconds")
"""What a report and its file have alike."""
COLUMNS = (
    *("query", "database", "accepted", "score", "num_inliers", "overlap_area_m2"),
    *("dissimilarity", "x_m", "y_m", "yaw_rad", "reason"),
)
"""Of ``closures.csv``."""


@dataclass(frozen=True)
class Decision:
    """What a person decided about a pair."""

    # whether the pair is a loop closure, whatever its score is; None leaves that to the thresholds
    accepted: bool | None = None
    note: str = ""  # why, in one line of at most `LONGEST_NOTE` letters

    def __post_init__(self) -> None:
        if len(self.note) > LONGEST_NOTE or not self.note.isprintable():
            raise InputError(
                f"'note' must be one line of at most {LONGEST_NOTE} letters, got {shown(self.note)}"
            )

    @property
    def reason(self) -> str:
        """Why a pair has the verdict that the decision gives it."""
        return "accepted by hand" if self.accepted else "refused by hand"


@dataclass(frozen=True, eq=False)
class ClosureReport:
    """The content of ``closures.json``."""

    dataset: str  # its name
    method: str  # its name
    seed: int  # seed of the random choices
    params: Mapping[str, object]  # all parameters, as nested tables
    # versions of gpgrad and of the libraries that the numbers depend on
    versions: Mapping[str, str]
    # time of each stage [s]; only this may differ between two runs with one seed
    seconds: Mapping[str, float]
    submaps: Mapping[str, int]  # number of points by the submap's id, in the dataset's order
    # every unordered pair that was compared once, with the verdict of the thresholds
    pairs: tuple[LoopClosure, ...]
    num_pairs_skipped: int = 0  # number of pairs that were not compared
    # those of each submap by its id, if the method fits them to every submap
    hyperparameters: Mapping[str, Hyperparameters] = field(
        default_factory=dict[str, Hyperparameters]
    )
    # what a person decided, by (query id, database id); it outweighs the thresholds
    decisions: Mapping[tuple[str, str], Decision] = field(
        default_factory=dict[tuple[str, str], Decision]
    )

    @property
    def accepted(self) -> tuple[LoopClosure, ...]:
        """The loop closures, as they are decided."""
        return tuple(closure for closure in restore_closures(self) if closure.accepted)

    @property
    def confirmed(self) -> tuple[tuple[str, str], ...]:
        """The pairs (query id, database id) that a person has accepted."""
        decided = ((closure.pair, self.decisions.get(closure.pair)) for closure in self.pairs)
        return tuple(pair for pair, decision in decided if decision and decision.accepted)


def report_closures(
    dataset: Dataset,
    result: DetectionResult,
    params: PipelineParams,
    *,
    method: str = "gradient",
    sources: Sequence[SubmapSource] | None = None,
    decisions: Mapping[tuple[str, str], Decision] | None = None,
) -> ClosureReport:
    """Make the content of the file from a detection.

    Args:
        dataset: The dataset that was searched.
        result: The result of the detection. If it has the values of automatic parameters, the
            file has these.
        params: The parameters of the detection.
        method: The name of the method.
        sources: Where the submaps were loaded from, if the dataset does not have their points.
        decisions: What a person decided, by (query id, database id).
    """
    params = result.params or params
    return ClosureReport(
        dataset=dataset.name,
        method=method,
        seed=params.registration.seed,
        params=asdict(params),
        versions={"gpgrad": __version__, "numpy": np.__version__, "opencv": cv2.__version__},
        seconds={stage: round(seconds, 3) for stage, seconds in result.seconds.items()},
        submaps={
            submap.id: submap.num_points
            for submap in (dataset.submaps if sources is None else sources)
        },
        pairs=tuple(map(rounded, result.closures)),
        num_pairs_skipped=math.comb(len(dataset.submaps), 2) - len(result.closures),
        hyperparameters=result.hyperparameters,
        decisions=decisions or {},
    )


def values_of(closure: LoopClosure) -> dict[str, Any]:
    """All values of a closure by their names in files; what is infinite is None."""
    registration = closure.registration
    values = {one.name: getattr(registration, one.name) for one in fields(registration)}
    for name in ("dissimilarity", "mean_dissimilarity"):
        values[name] = values[name] if math.isfinite(values[name]) else None
    return values | {
        "query": closure.query_id,
        "database": closure.database_id,
        "num_inliers": registration.num_inliers,
        "accepted": closure.accepted,
        "reason": closure.reason,
        "images": closure.images,
        "context": closure.context,
        "undecided": closure.undecided,
    }


def closure_of(values: Mapping[str, Any]) -> LoopClosure:
    """Make a closure of its values by name; parts may be tuples, and what is None is not known."""
    present = {name: value for name, value in values.items() if value is not None}
    for name, kind in PARTS.items():
        if isinstance(present.get(name), tuple):
            present[name] = kind(*present[name])
    arguments: dict[str, Any] = dict(UNKNOWN)
    arguments |= {
        one.name: present[one.name] for one in fields(Registration) if one.name in present
    }
    return LoopClosure(
        present["query"],
        present["database"],
        Registration(**arguments),
        present["accepted"],
        present["reason"],
        present.get("images"),
        present.get("context"),
        present.get("undecided", False),
    )


class _Motion(Struct):
    x: Coordinate
    y: Coordinate
    yaw: Annotated[float, Meta(ge=-MAX_YAW, le=MAX_YAW)]


class _Row(Struct):
    """A pair as JSON and TOML have it, in this order; `Registration` explains the names."""

    query: str
    database: str
    num_inliers: Associations
    score: Finite
    dissimilarity: NotNegative | None
    overlap_area: NotNegative
    accepted: bool
    reason: str
    T_database_query: _Motion | None
    z_offset: Finite | None = None
    covariance: tuple[CovarianceRow, CovarianceRow, CovarianceRow] | None = None
    overlap_middle: tuple[Coordinate, Coordinate] | None = None
    z_std: NotNegative | None = None
    scale: NotNegative | None = None
    agreement: Agreement | None = None
    decision: Decision | None = None
    images: ImageVerdict | None = None
    mean_dissimilarity: NotNegative | None = None
    context: Context | None = None

    def closure(self, where: str) -> LoopClosure:
        """Make the closure as the thresholds judge it."""
        if self.query == self.database:
            raise InputError(
                f"{where}: 'database' must be another submap than the query, got {self.query!r}"
            )
        motion, covariance = self.T_database_query, self.covariance
        closure = closure_of(
            structs.asdict(self)
            | {
                "T_database_query": motion and structs.astuple(motion),
                "covariance": covariance and _symmetric(np.array(covariance), where),
                # Which ones they are is not known; a view takes no memory for each.
                "inliers": np.broadcast_to(np.True_, self.num_inliers),
            }
        )
        if motion is None and self.decision is not None and self.decision.accepted:
            raise InputError(
                f"{where}: 'decision' accepts the pair, but it has no motion, T_database_query"
            )
        return closure


class _Submap(Struct):
    id: str
    num_points: Count
    length_scale: NotNegative | None = None
    signal_std: NotNegative | None = None
    noise_std: NotNegative | None = None

    @property
    def hyperparameters(self) -> Hyperparameters | None:
        """The submap's own, if the file has them."""
        if self.length_scale is None or self.signal_std is None or self.noise_std is None:
            return None
        return Hyperparameters(self.length_scale, self.signal_std, self.noise_std)


class _Report(Struct):
    """The file as a whole; `ClosureReport` explains the keys."""

    dataset: str
    method: str
    seed: Count
    params: dict[str, object]
    versions: dict[str, str]
    seconds: dict[str, NotNegative]
    submaps: list[_Submap]
    pairs: list[_Row]
    num_pairs_skipped: Annotated[int, Meta(ge=0, le=MOST_PAIRS)] | None = None


def read_closures(path: Path | str) -> ClosureReport:
    """Read a file that `write_closures` wrote.

    Args:
        path: The file; any tool may have written it in the same format.

    Raises:
        InputError: If the file is not JSON, or a value is missing or is none that it can be; the
            message names the file, the pair and the key.
        OSError: If the file cannot be read.
    """
    where = f"{path}: not a file of loop closures"
    content = as_record(read_json(Path(path)), _Report, where, RULES)
    submaps = {submap.id: submap.num_points for submap in content.submaps}
    if len(submaps) < len(content.submaps):
        raise InputError(f"{where}: 'submaps' names a submap twice")
    own = {submap.id: submap.hyperparameters for submap in content.submaps}
    return ClosureReport(
        **{name: getattr(content, name) for name in AS_THEY_ARE},
        submaps=submaps,
        pairs=_check_pairs(content.pairs, submaps, where),
        num_pairs_skipped=content.num_pairs_skipped or 0,  # other tools may not count them
        hyperparameters={id: numbers for id, numbers in own.items() if numbers is not None},
        decisions={
            (row.query, row.database): row.decision for row in content.pairs if row.decision
        },
    )


def _check_pairs(
    rows: Sequence[_Row], submaps: Collection[str], where: str
) -> tuple[LoopClosure, ...]:
    """Check that each pair is of two submaps of the file, and that each is there once."""
    pairs: list[LoopClosure] = []
    compared: set[frozenset[str]] = set()
    for k, row in enumerate(rows):
        place = f"{where}, pairs[{k}]"
        closure = row.closure(place)
        for name in closure.pair:
            if submaps and name not in submaps:  # other tools may list no submaps
                raise InputError(f"{place}: names submap {name!r}, which 'submaps' has not")
        both = frozenset(closure.pair)
        if both in compared:
            raise InputError(
                f"{place}: has the pair of {row.query!r} and {row.database!r} a second time"
            )
        compared.add(both)
        pairs.append(closure)
    return tuple(pairs)


def read_row(values: object, where: str) -> LoopClosure:
    """Read a closure from the row that `row_of` wrote; InputError if a value cannot be one."""
    return as_record(values, _Row, where, RULES).closure(where)


def _symmetric(matrix: Float[Array, "3 3"], where: str) -> Float[Array, "3 3"]:
    """Check a covariance that any tool may have written; with a bad one no graph can be solved."""
    # Sums in single precision leave the two halves of a matrix equal to six digits only.
    if np.abs(matrix - matrix.T).max() > 1e-5 * np.abs(matrix).max():
        raise InputError(f"{where}: a covariance must be symmetric")
    symmetric = 0.5 * (matrix + matrix.T)
    if not np.linalg.eigvalsh(symmetric)[0] > 0:
        raise InputError(f"{where}: a covariance must be positive definite")
    return symmetric


def restore_closures(report: ClosureReport) -> tuple[LoopClosure, ...]:
    """The loop closures of a report as a person decided, or else as the thresholds judge.

    A file has the number of inliers, but not which associations they are, and it does not have
    the correlation.

    Args:
        report: The content of the file.

    Returns:
        The loop closures, accepted and refused, in the order of the file.
    """
    return tuple(
        closure_as_decided(closure, report.decisions.get(closure.pair)) for closure in report.pairs
    )


def closure_as_decided(closure: LoopClosure, decision: Decision | None) -> LoopClosure:
    """Apply a person's decision to the verdict; without a motion there is nothing to accept."""
    if decision is None or decision.accepted is None:
        return closure
    accepted = decision.accepted and closure.registration.T_database_query is not None
    return replace(closure, accepted=accepted, reason=decision.reason, refusal=None, by_hand=True)


def rounded(closure: LoopClosure) -> LoopClosure:
    """Round to the digits of a file; a covariance with which no graph can be solved is dropped."""
    original = closure.registration
    motion, covariance = original.T_database_query, _usable(original.covariance)
    numbers = ("dissimilarity", "mean_dissimilarity", "overlap_area", "score", "scale", "agreement")
    digits = {name: _nine_digits(getattr(original, name)) for name in numbers}
    for name, unknown in (("z_offset", 0.0), ("z_std", None), ("overlap_middle", None)):
        value = getattr(original, name)
        digits[name] = unknown if covariance is None else _nine_digits(value)
    if motion is not None and math.hypot(motion.x, motion.y) <= FAR:
        motion = _nine_digits(motion)  # of one that leads far the yaw has a long lever
    registration = replace(original, T_database_query=motion, covariance=covariance, **digits)
    return replace(closure, registration=registration, context=_nine_digits(closure.context))


def _nine_digits(value: Any) -> Any:
    """Round numbers, a nanometre in a metre; further digits are arithmetic noise."""
    if value is None:
        return None
    if isinstance(value, tuple):
        return tuple(map(_nine_digits, value))
    if is_dataclass(value) and not isinstance(value, type):
        parts = astuple(value)
        return type(value)(*(p if isinstance(p, int) else _nine_digits(p) for p in parts))
    return float(f"{value:z.9g}")


def _usable(covariance: Float[Array, "3 3"] | None) -> Float[Array, "3 3"] | None:
    """Make a covariance symmetric and round it; None if it is not positive definite then."""
    if covariance is None or not np.isfinite(covariance).all():
        return None
    symmetric = 0.5 * (covariance + covariance.T)
    symmetric = np.array([[_nine_digits(value) for value in row] for row in symmetric.tolist()])
    return symmetric if np.linalg.eigvalsh(symmetric)[0] > 0 else None


def row_of(closure: LoopClosure, decision: Decision | None = None) -> dict[str, Any]:
    """Write a closure as the row that files have of it; `read_row` reads it back."""
    values = values_of(closure) | {"decision": decision}
    if values["covariance"] is None and not values["z_offset"]:
        values["z_offset"] = None
    row = as_builtins({name: values[name] for name in _Row.__struct_fields__})
    return {name: value for name, value in row.items() if value is not None or name not in LEFT_OUT}


def count_images(verdicts: Iterable[ImageVerdict | None]) -> str:
    """Count the images' verdicts on pairs, in words; an empty text if there are none.

    >>> count_images([ImageVerdict("silent", "too dark", 0, 0), None])
    'images: 0 confirmed, 0 contradicted, 1 silent'
    """
    words = [verdict.verdict for verdict in verdicts if verdict is not None]
    if not words:
        return ""
    return "images: " + ", ".join(f"{words.count(word):,} {word}" for word in get_args(ImageSays))


def write_closures(path: Path | str, report: ClosureReport) -> None:
    """Write a report as JSON, completely or not at all.

    Args:
        path: The file.
        report: Its content, such as `report_closures` makes.

    Raises:
        InputError: If the file cannot be written there.
        OSError: If writing fails.
    """
    with ClosureWriter(path) as writer:
        for closure in report.pairs:
            writer.add_row(row_of(closure, report.decisions.get(closure.pair)))
        writer.write(report)


class ClosureWriter:
    """Writes ``closures.json`` as pairs are compared, which wait in a nameless file beside it."""

    def __init__(self, path: Path | str) -> None:
        """Begin a file; InputError if it cannot be written there."""
        self._path, self.num_pairs = check_output(path), 0
        with naming(self._path):
            self._rows = tempfile.TemporaryFile(  # noqa: SIM115 - closed at the end of the block
                "w+", encoding="utf-8", dir=self._path.parent
            )

    def __enter__(self) -> "ClosureWriter":
        return self

    def __exit__(self, *_: object) -> None:
        self._rows.close()

    def add(self, closure: LoopClosure) -> None:
        self.add_row(row_of(rounded(closure)))

    def add_row(self, row: Mapping[str, object]) -> None:
        """Add a pair as `row_of` writes it."""
        # NaN and Infinity are not JSON; an error here is better than one in a reader.
        text = json.dumps(row, ensure_ascii=False, allow_nan=False)
        with naming(self._path):
            self._rows.write(f"{',' if self.num_pairs else ''}\n  {text}")
        self.num_pairs += 1

    def write(self, report: ClosureReport) -> None:
        """Write the added pairs after the rest of a report; InputError if that fails."""
        content = {name: getattr(report, name) for name in AS_THEY_ARE} | {
            "submaps": [
                {"id": id, "num_points": count}
                | (asdict(report.hyperparameters[id]) if id in report.hyperparameters else {})
                for id, count in report.submaps.items()
            ],
            "num_pairs_skipped": report.num_pairs_skipped,
        }
        head = json.dumps(content, indent=1, ensure_ascii=False, allow_nan=False)
        with (
            replacing(self._path) as unfinished,
            unfinished.open("w", encoding="utf-8", newline="\n") as file,
        ):
            file.write(head.removesuffix("\n}") + ',\n "pairs": [')
            self._rows.seek(0)
            shutil.copyfileobj(self._rows, file, 1_000_000)
            file.write("\n ]\n}\n" if self.num_pairs else "]\n}\n")


def write_closure_table(path: Path | str, report: ClosureReport) -> None:
    """Write a report's pairs as CSV; x, y and yaw are empty where no motion was found."""
    with replacing(path) as unfinished, unfinished.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(COLUMNS)
        for closure in report.pairs:
            registration = closure.registration
            motion = registration.T_database_query
            writer.writerow(
                (
                    *closure.pair,
                    str(closure.accepted).lower(),
                    _number(registration.score),
                    registration.num_inliers,
                    _number(registration.overlap_area),
                    _number(registration.dissimilarity),
                    *(("", "", "") if motion is None else map(_number, astuple(motion))),
                    closure.reason,
                )
            )


def _number(value: float) -> str:
    """Write nine digits, as ``closures.json`` has them: 9.94881405e+11, not 994881405000.0."""
    return f"{value:z.9g}"
