"""``closures.json``, the verdict on every compared pair of submaps, and ``closures.csv``."""

import csv
import json
import math
import shutil
import tempfile
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import asdict, astuple, dataclass, field
from pathlib import Path
from typing import Annotated, TypeAlias, get_args

import cv2
import numpy as np
from jaxtyping import Float
from msgspec import Meta, Struct, structs

from gpgrad_core.detection import DetectionResult, PipelineParams
from gpgrad_core.errors import InputError
from gpgrad_core.gp.likelihood import Hyperparameters
from gpgrad_core.io.records.files import check_output, replacing
from gpgrad_core.reading.records import Count, Finite, NotNegative, as_record, read_json, shown
from gpgrad_core.se2 import FAR, SE2
from gpgrad_core.types import (
    MAX_COORDINATE,
    Agreement,
    Array,
    Context,
    Dataset,
    ImageSays,
    ImageVerdict,
    LoopClosure,
    Registration,
    SubmapSource,
)
from gpgrad_core.version import VERSION

MOST_INLIERS = 10_000_000
"""Of a pair; each becomes a truth value in memory."""
MOST_PAIRS = 10**15
"""Of a dataset; a hundred times as many submaps as anybody has."""
MAX_YAW = 1e6
"""Of a motion [rad]; from there on an angle has lost ten of its digits."""
MAX_COVARIANCE = MAX_COORDINATE**2
"""[m²]"""


LONGEST_NOTE = 200
"""Letters of a note on a pair."""
Inliers: TypeAlias = Annotated[int, Meta(ge=0, le=MOST_INLIERS)]
Coordinate: TypeAlias = Annotated[float, Meta(ge=-MAX_COORDINATE, le=MAX_COORDINATE)]
Covariance: TypeAlias = Annotated[float, Meta(ge=-MAX_COVARIANCE, le=MAX_COVARIANCE)]
CovarianceRow: TypeAlias = tuple[Covariance, Covariance, Covariance]
RULES = {
    "covariance": "three rows of three finite numbers (a covariance must be 3 x 3)",
    "verdict": f"one of {', '.join(get_args(ImageSays))}",
}
"""What values of the file must be, where their types do not say it in words."""
COLUMNS = (
    "query",
    "database",
    "accepted",
    "score",
    "num_inliers",
    "overlap_area_m2",
    "dissimilarity",
    "x_m",
    "y_m",
    "yaw_rad",
    "reason",
)
"""Of ``closures.csv``."""


@dataclass(frozen=True)
class Decision:
    """What a person decided about a pair."""

    # whether the pair is a loop closure, whatever its score is; None leaves that to the thresholds
    accepted: bool | None = None
    note: str = ""  # why, in one line of at most `LONGEST_NOTE` letters

    def __post_init__(self) -> None:
        """Check the note.

        Raises:
            InputError: If it is too long, or holds a line end or another control character.
        """
        if len(self.note) > LONGEST_NOTE or not self.note.isprintable():
            raise InputError(
                f"'note' must be one line of at most {LONGEST_NOTE} letters, got {shown(self.note)}"
            )

    @property
    def reason(self) -> str:
        """Why a pair has the verdict that the decision gives it."""
        return "accepted by hand" if self.accepted else "refused by hand"


@dataclass(frozen=True)
class PairRecord:
    """One pair of submaps in the file.

    Attributes:
        query: Id of the later submap.
        database: Id of the earlier one.
        num_inliers: Number of associations that agree with the motion.
        score: A pair with a higher score is more likely a loop closure.
        dissimilarity: The paper's SSD metric h [1/m⁴]; infinite if the maps were not compared.
        overlap_area: Trusted area that both maps share [m²].
        accepted: Whether the pair is a loop closure.
        reason: Why it is accepted or refused.
        T_database_query: Maps points of the query's frame into the database's; None if no motion
            was found.
        z_offset: Height to add to the query so that it lies on the database [m]; None if it is not
            known.
        covariance: Covariance of x [m], y [m] and yaw [rad], row by row; None if it is not known.
        overlap_middle: Where it is that, see `Registration`; None if it is the query's origin.
        z_std: Standard deviation of ``z_offset`` [m]; None if it is not known.
        scale: Scale at which the maps were compared [m]; None if they were not compared.
        agreement: How well the heights agree; None if it is not known.
        decision: What a person decided about the pair; it outweighs `accepted` and `reason`. None
            if nobody did.
        images: What camera images say of the motion; None if they were not asked.
        mean_dissimilarity: h divided by the number of common cells; None if it is not known.
        context: What the other pairs of the dataset say; None if the pair was judged alone.
    """

    query: str
    database: str
    num_inliers: int
    score: float
    dissimilarity: float
    overlap_area: float
    accepted: bool
    reason: str
    T_database_query: SE2 | None
    z_offset: float | None = None
    covariance: tuple[tuple[float, ...], ...] | None = None
    overlap_middle: tuple[float, float] | None = None
    z_std: float | None = None
    scale: float | None = None
    agreement: Agreement | None = None
    decision: Decision | None = None
    images: ImageVerdict | None = None
    mean_dissimilarity: float | None = None
    context: Context | None = None

    @property
    def verdict(self) -> bool:
        """Whether the pair is a loop closure, by the decision if there is one."""
        decided = None if self.decision is None else self.decision.accepted
        return self.accepted if decided is None else decided

    @property
    def is_confirmed(self) -> bool:
        """Whether a person has accepted the pair."""
        return self.decision is not None and self.decision.accepted is True


@dataclass(frozen=True)
class ClosureReport:
    """The content of ``closures.json``."""

    dataset: str  # the dataset's name
    method: str  # the method that detected the closures
    seed: int  # seed of the random choices
    params: Mapping[str, object]  # all parameters, as nested tables
    # versions of gpgrad and of the libraries that the numbers depend on
    versions: Mapping[str, str]
    # time of each stage [s]; only this may differ between two runs with one seed
    seconds: Mapping[str, float]
    submaps: Mapping[str, int]  # number of points by the submap's id, in the dataset's order
    pairs: tuple[PairRecord, ...]  # every unordered pair that was compared once
    num_pairs_skipped: int = 0  # number of pairs that were not compared
    # those of each submap by its id, if the method fits them to every submap
    hyperparameters: Mapping[str, Hyperparameters] = field(
        default_factory=dict[str, Hyperparameters]
    )

    @property
    def accepted(self) -> tuple[PairRecord, ...]:
        """The loop closures, as they are decided."""
        return tuple(pair for pair in self.pairs if pair.verdict)

    @property
    def confirmed(self) -> tuple[tuple[str, str], ...]:
        """The pairs (query id, database id) that a person has accepted."""
        return tuple((pair.query, pair.database) for pair in self.pairs if pair.is_confirmed)


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

    Returns:
        The content of ``closures.json``, with the pairs that the result has.
    """
    params = result.params or params
    return ClosureReport(
        dataset=dataset.name,
        method=method,
        seed=params.registration.seed,
        params=asdict(params),
        versions={"gpgrad": VERSION, "numpy": np.__version__, "opencv": cv2.__version__},
        seconds={stage: round(seconds, 3) for stage, seconds in result.seconds.items()},
        submaps={
            submap.id: submap.num_points
            for submap in (dataset.submaps if sources is None else sources)
        },
        pairs=tuple(
            record_of(closure, (decisions or {}).get((closure.query_id, closure.database_id)))
            for closure in result.closures
        ),
        num_pairs_skipped=math.comb(len(dataset.submaps), 2) - len(result.closures),
        hyperparameters=result.hyperparameters,
    )


class _Motion(Struct):
    x: Coordinate
    y: Coordinate
    yaw: Annotated[float, Meta(ge=-MAX_YAW, le=MAX_YAW)]


class _Agreement(Struct):
    difference: NotNegative
    possible: NotNegative
    relief: NotNegative


class _Images(Struct):
    verdict: ImageSays
    reason: str
    num_associations: Inliers
    num_inliers: Inliers


class _Context(Struct):
    own_score: NotNegative
    score: NotNegative
    misfit: NotNegative
    support: Finite
    places: Count


class _Pair(Struct):
    """A pair as the file has it; `PairRecord` explains the keys."""

    query: str
    database: str
    num_inliers: Inliers
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
    agreement: _Agreement | None = None
    decision: Decision | None = None
    images: _Images | None = None
    mean_dissimilarity: NotNegative | None = None
    context: _Context | None = None

    def record(self, where: str) -> PairRecord:
        """Make the record in memory.

        Raises:
            InputError: If values contradict each other; the message begins with `where`.
        """
        if self.query == self.database:
            raise InputError(
                f"{where}: 'database' must be another submap than the query, got {self.query!r}"
            )
        motion, agreement, images = self.T_database_query, self.agreement, self.images
        context = self.context
        values = structs.asdict(self)
        values |= {
            "dissimilarity": math.inf if self.dissimilarity is None else self.dissimilarity,
            "T_database_query": motion and SE2(*structs.astuple(motion)),
            "covariance": self.covariance and _symmetric(np.array(self.covariance), where),
            "agreement": agreement and Agreement(*structs.astuple(agreement)),
            "images": images and ImageVerdict(*structs.astuple(images)),
            "context": context and Context(*structs.astuple(context)),
        }
        pair = PairRecord(**values)
        if pair.is_confirmed and motion is None:
            raise InputError(
                f"{where}: 'decision' accepts the pair, but it has no motion, T_database_query"
            )
        return pair


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
    pairs: list[_Pair]
    num_pairs_skipped: Annotated[int, Meta(ge=0, le=MOST_PAIRS)] | None = None


def read_closures(path: Path | str) -> ClosureReport:
    """Read a file that `write_closures` wrote.

    Args:
        path: The file; any tool may have written it in the same format.

    Returns:
        Its content.

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
        dataset=content.dataset,
        method=content.method,
        seed=content.seed,
        params=content.params,
        versions=content.versions,
        seconds=content.seconds,
        submaps=submaps,
        pairs=_check_pairs(content.pairs, submaps, where),
        num_pairs_skipped=content.num_pairs_skipped or 0,  # other tools may not count them
        hyperparameters={id: numbers for id, numbers in own.items() if numbers is not None},
    )


def _check_pairs(
    rows: Sequence[_Pair], submaps: Collection[str], where: str
) -> tuple[PairRecord, ...]:
    """Check that each pair is of two submaps of the file, and that each is there once."""
    pairs: list[PairRecord] = []
    seen: set[frozenset[str]] = set()
    for k, row in enumerate(rows):
        place = f"{where}, pairs[{k}]"
        pair = row.record(place)
        for name in (pair.query, pair.database):
            if submaps and name not in submaps:  # other tools may list no submaps
                raise InputError(f"{place}: names submap {name!r}, which 'submaps' has not")
        both = frozenset((pair.query, pair.database))
        if both in seen:
            raise InputError(
                f"{place}: has the pair of {pair.query!r} and {pair.database!r} a second time"
            )
        seen.add(both)
        pairs.append(pair)
    return tuple(pairs)


def read_pair(values: object, where: str) -> PairRecord:
    """Read a pair from the table that `table_of` wrote.

    Raises:
        InputError: If a value is missing or is none that it can be.
    """
    return as_record(values, _Pair, where, RULES).record(where)


def _symmetric(matrix: Float[Array, "3 3"], where: str) -> tuple[tuple[float, ...], ...]:
    """Check a covariance that any tool may have written; with a bad one no graph can be solved."""
    # Sums in single precision leave the two halves of a matrix equal to six digits only.
    if np.abs(matrix - matrix.T).max() > 1e-5 * np.abs(matrix).max():
        raise InputError(f"{where}: a covariance must be symmetric")
    symmetric = 0.5 * (matrix + matrix.T)
    if not np.linalg.eigvalsh(symmetric)[0] > 0:
        raise InputError(f"{where}: a covariance must be positive definite")
    return tuple(tuple(row) for row in symmetric.tolist())


def restore_closures(report: ClosureReport) -> tuple[LoopClosure, ...]:
    """Turn the content of a file back into loop closures, as far as possible.

    The file has the number of inliers, but not which associations they are, and it does not have
    the correlation.

    Args:
        report: The content of the file.

    Returns:
        The loop closures, accepted and refused, in the order of the file.
    """
    return tuple(closure_of(pair) for pair in report.pairs)


def closure_of(pair: PairRecord) -> LoopClosure:
    """Turn a record back into a loop closure, as `restore_closures` does."""
    registration = Registration(
        pair.T_database_query,
        np.ones(pair.num_inliers, dtype=np.bool_),
        pair.dissimilarity,
        pair.overlap_area,
        0.0,
        pair.score,
        z_offset=pair.z_offset or 0.0,
        covariance=None if pair.covariance is None else np.array(pair.covariance),
        overlap_middle=pair.overlap_middle,
        z_std=pair.z_std,
        scale=pair.scale,
        agreement=pair.agreement,
        mean_dissimilarity=math.inf if pair.mean_dissimilarity is None else pair.mean_dissimilarity,
    )
    decided = pair.decision is not None and pair.decision.accepted is not None
    reason = pair.decision.reason if pair.decision is not None and decided else pair.reason
    return LoopClosure(
        pair.query, pair.database, registration, pair.verdict, reason, pair.images, pair.context
    )


def record_of(closure: LoopClosure, decision: Decision | None = None) -> PairRecord:
    """Make the record of a verdict, and of what a person decided about it."""
    registration = closure.registration
    motion, covariance = registration.T_database_query, _usable(registration.covariance)
    context = closure.context
    if context is not None:
        context = Context(
            _rounded(context.own_score),
            _rounded(context.score),
            _rounded(context.misfit),
            _rounded(context.support),
            context.places,
        )
    return PairRecord(
        query=closure.query_id,
        database=closure.database_id,
        num_inliers=registration.num_inliers,
        score=_rounded(registration.score),
        dissimilarity=_rounded(registration.dissimilarity),
        overlap_area=_rounded(registration.overlap_area),
        accepted=closure.accepted,
        reason=closure.reason,
        T_database_query=motion and _rounded_motion(motion),
        # Without a covariance the heights were not aligned either.
        z_offset=None if covariance is None else _rounded(registration.z_offset),
        covariance=None
        if covariance is None
        else tuple(tuple(_rounded(value) for value in row) for row in covariance.tolist()),
        overlap_middle=None
        if covariance is None or registration.overlap_middle is None
        else (_rounded(registration.overlap_middle[0]), _rounded(registration.overlap_middle[1])),
        z_std=None
        if covariance is None or registration.z_std is None
        else _rounded(registration.z_std),
        scale=None if registration.scale is None else _rounded(registration.scale),
        agreement=None
        if registration.agreement is None
        else Agreement(*(_rounded(value) for value in astuple(registration.agreement))),
        decision=decision,
        images=closure.images,
        mean_dissimilarity=_rounded(registration.mean_dissimilarity)
        if math.isfinite(registration.mean_dissimilarity)
        else None,
        context=context,
    )


def table_of(pair: PairRecord) -> dict[str, object]:
    """Write a record as the table that the file has of it; `read_pair` reads it back."""
    finite = pair.dissimilarity if math.isfinite(pair.dissimilarity) else None
    table: dict[str, object] = {**asdict(pair), "dissimilarity": finite}
    for name in ("overlap_middle", "decision", "images", "mean_dissimilarity", "context"):
        if table[name] is None:
            del table[name]
    return table


def count_images(verdicts: Iterable[ImageVerdict | None]) -> str:
    """Count what images say of pairs, in words; an empty text if none were asked.

    >>> count_images([ImageVerdict("silent", "too dark", 0, 0), None])
    'images: 0 confirmed, 0 contradicted, 1 silent'
    """
    words = [verdict.verdict for verdict in verdicts if verdict is not None]
    if not words:
        return ""
    return "images: " + ", ".join(f"{words.count(word):,} {word}" for word in get_args(ImageSays))


def _usable(covariance: Float[Array, "3 3"] | None) -> Float[Array, "3 3"] | None:
    """Make a covariance exactly symmetric; None if it is not positive definite."""
    if covariance is None or not np.isfinite(covariance).all():
        return None
    symmetric = 0.5 * (covariance + covariance.T)
    return symmetric if np.linalg.eigvalsh(symmetric)[0] > 0 else None


def _rounded(value: float) -> float:
    """Round to nine digits, a nanometre in a metre; further digits are arithmetic noise."""
    return float(f"{value:z.9g}")


def _rounded_motion(motion: SE2) -> SE2:
    """Round a motion; of one that leads far all digits count, since its yaw has a long lever."""
    if math.hypot(motion.x, motion.y) > FAR:
        return motion
    return SE2(_rounded(motion.x), _rounded(motion.y), _rounded(motion.yaw))


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
        for pair in report.pairs:
            writer.add_record(pair)
        writer.write(report)


class ClosureWriter:
    """Writes ``closures.json`` as the pairs are compared, so that they need not fit into memory.

    The pairs wait in a file without a name beside the output. `write` puts everything else before
    them; without it nothing is left.
    """

    def __init__(self, path: Path | str) -> None:
        """Begin a file.

        Raises:
            InputError: If the file cannot be written there.
        """
        self._path, self.num_pairs = check_output(path), 0
        self._rows = tempfile.TemporaryFile(  # noqa: SIM115 - closed at the end of the block
            "w+", encoding="utf-8", dir=self._path.parent
        )

    def __enter__(self) -> "ClosureWriter":
        """Begin a ``with`` block."""
        return self

    def __exit__(self, *_: object) -> None:
        """Drop what was not written."""
        self._rows.close()

    def add(self, closure: LoopClosure) -> None:
        """Add the verdict on a pair."""
        self.add_record(record_of(closure))

    def add_record(self, pair: PairRecord) -> None:
        """Add a pair in the form of the file."""
        # NaN and Infinity are not JSON; an error here is better than one in a reader.
        row = json.dumps(table_of(pair), ensure_ascii=False, allow_nan=False)
        self._rows.write(f"{',' if self.num_pairs else ''}\n  {row}")
        self.num_pairs += 1

    def write(self, report: ClosureReport) -> None:
        """Write the file with all pairs that were added.

        The report has everything but the pairs.

        Raises:
            InputError: If the file cannot be written there.
            OSError: If writing fails.
        """
        content = {
            "dataset": report.dataset,
            "method": report.method,
            "seed": report.seed,
            "params": report.params,
            "versions": report.versions,
            "seconds": report.seconds,
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
    """Write a report's pairs as comma-separated values with a header.

    x, y and yaw are those of ``T_database_query``; they are empty where no motion was found.

    Raises:
        InputError: If the file cannot be written there.
        OSError: If writing fails.
    """
    with replacing(path) as unfinished, unfinished.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(COLUMNS)
        for pair in report.pairs:
            motion = pair.T_database_query
            place = () if motion is None else (motion.x, motion.y, motion.yaw)
            writer.writerow(
                (
                    pair.query,
                    pair.database,
                    str(pair.accepted).lower(),
                    _number(pair.score),
                    pair.num_inliers,
                    _number(pair.overlap_area),
                    _number(pair.dissimilarity),
                    *(map(_number, place) if place else ("", "", "")),
                    pair.reason,
                )
            )


def _number(value: float) -> str:
    """Write nine digits, as ``closures.json`` has them: 9.94881405e+11, not 994881405000.0."""
    return f"{value:z.9g}"
