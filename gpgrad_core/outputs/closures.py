"""``closures.json``: the verdict on every compared pair of submaps, and how it was reached."""

import math
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import asdict, astuple, dataclass, field, fields
from pathlib import Path
from typing import Any, cast, get_args

import cv2
import numpy as np
from jaxtyping import Float

from gpgrad_core.errors import InputError
from gpgrad_core.gp.likelihood import Hyperparameters
from gpgrad_core.pipeline import DetectionResult, PipelineParams
from gpgrad_core.reading.json_files import Record, is_number, read_json
from gpgrad_core.se2 import SE2
from gpgrad_core.types import (
    MAX_COORDINATE,
    Agreement,
    Array,
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


OWN = tuple(one.name for one in fields(Hyperparameters))
"""Keys of a submap for its own hyperparameters."""

LONGEST_NOTE = 200
"""Letters of a note on a pair."""


@dataclass(frozen=True)
class Decision:
    """What a person decided about a pair.

    Attributes:
        accepted: Whether the pair is a loop closure, whatever its score is; None leaves that to
            the thresholds.
        note: Why, in one line of at most `LONGEST_NOTE` letters.
    """

    accepted: bool | None = None
    note: str = ""

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
        z_std: Standard deviation of ``z_offset`` [m]; None if it is not known.
        scale: Scale at which the maps were compared [m]; None if they were not compared.
        agreement: How well the heights agree; None if it is not known.
        decision: What a person decided about the pair; it outweighs `accepted` and `reason`. None
            if nobody did.
        images: What camera images say of the motion; None if they were not asked.
        mean_dissimilarity: h divided by the number of common cells; None if it is not known.
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
    z_std: float | None = None
    scale: float | None = None
    agreement: Agreement | None = None
    decision: Decision | None = None
    images: ImageVerdict | None = None
    mean_dissimilarity: float | None = None

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
    """The content of ``closures.json``.

    Attributes:
        dataset: The dataset's name.
        method: The method that detected the closures.
        seed: Seed of the random choices.
        params: All parameters, as nested tables.
        versions: Versions of gpgrad and of the libraries that the numbers depend on.
        seconds: Time of each stage [s]; only this may differ between two runs with one seed.
        submaps: Number of points by the submap's id, in the dataset's order.
        pairs: Every unordered pair that was compared once.
        num_pairs_skipped: Number of pairs that were not compared.
        hyperparameters: Those of each submap by its id, if the method fits them to every submap.
    """

    dataset: str
    method: str
    seed: int
    params: Mapping[str, Any]
    versions: Mapping[str, str]
    seconds: Mapping[str, float]
    submaps: Mapping[str, int]
    pairs: tuple[PairRecord, ...]
    num_pairs_skipped: int = 0
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


def read_closures(path: Path | str) -> ClosureReport:
    """Read a file that `closure_writer.write_closures` wrote.

    Args:
        path: The file; any tool may have written it in the same format.

    Returns:
        Its content.

    Raises:
        InputError: If the file is not JSON, or a value is missing or is none that it can be; the
            message names the file, the pair and the key.
        OSError: If the file cannot be read.
    """
    path = Path(path)
    content = Record.of(read_json(path), f"{path}: not a file of loop closures")
    dataset, method, seed = content.text("dataset"), content.text("method"), content.count("seed")
    submaps = [(one.text("id"), one.count("num_points")) for one in content.records("submaps")]
    known = dict(submaps)
    if len(known) < len(submaps):
        raise InputError(f"{content.where}: 'submaps' names a submap twice")
    return ClosureReport(
        dataset=dataset,
        method=method,
        seed=seed,
        params=content.record("params").values,
        versions=_texts(content.record("versions")),
        seconds=_seconds(content.record("seconds")),
        submaps=known,
        pairs=_read_pairs(content.records("pairs"), known),
        num_pairs_skipped=0  # other tools may not count them
        if content.values.get("num_pairs_skipped") is None
        else content.count("num_pairs_skipped", MOST_PAIRS),
        hyperparameters={
            one.text("id"): Hyperparameters(*(one.number(name, 0.0) for name in OWN))
            for one in content.records("submaps")
            if all(name in one.values for name in OWN)
        },
    )


def _texts(record: Record) -> dict[str, str]:
    return {key: record.text(key) for key in record.values}


def _seconds(record: Record) -> dict[str, float]:
    return {key: record.number(key, 0.0) for key in record.values}


def _read_pairs(records: Sequence[Record], known: Collection[str]) -> tuple[PairRecord, ...]:
    """Read the pairs, each of two submaps of the file, and each once."""
    pairs: list[PairRecord] = []
    seen: set[frozenset[str]] = set()
    for record in records:
        pair = read_pair(record)
        for name in (pair.query, pair.database):
            if known and name not in known:  # other tools may list no submaps
                raise InputError(f"{record.where}: names submap {name!r}, which 'submaps' has not")
        both = frozenset((pair.query, pair.database))
        if len(both) == 1:
            raise InputError(f"{record.where}: pairs submap {pair.query!r} with itself")
        if both in seen:
            raise InputError(
                f"{record.where}: has the pair of {pair.query!r} and {pair.database!r} a second "
                "time"
            )
        seen.add(both)
        pairs.append(pair)
    return tuple(pairs)


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
        z_std=pair.z_std,
        scale=pair.scale,
        agreement=pair.agreement,
        mean_dissimilarity=math.inf if pair.mean_dissimilarity is None else pair.mean_dissimilarity,
    )
    decided = pair.decision is not None and pair.decision.accepted is not None
    reason = pair.decision.reason if pair.decision is not None and decided else pair.reason
    return LoopClosure(pair.query, pair.database, registration, pair.verdict, reason, pair.images)


def record_of(closure: LoopClosure, decision: Decision | None = None) -> PairRecord:
    """Make the record of a verdict, and of what a person decided about it."""
    registration = closure.registration
    motion, covariance = registration.T_database_query, _usable(registration.covariance)
    return PairRecord(
        query=closure.query_id,
        database=closure.database_id,
        num_inliers=registration.num_inliers,
        score=_rounded(registration.score),
        dissimilarity=_rounded(registration.dissimilarity),
        overlap_area=_rounded(registration.overlap_area),
        accepted=closure.accepted,
        reason=closure.reason,
        T_database_query=motion
        and SE2(_rounded(motion.x), _rounded(motion.y), _rounded(motion.yaw)),
        # Without a covariance the heights were not aligned either.
        z_offset=None if covariance is None else _rounded(registration.z_offset),
        covariance=None
        if covariance is None
        else tuple(tuple(_rounded(value) for value in row) for row in covariance.tolist()),
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
    )


def table_of(pair: PairRecord) -> dict[str, Any]:
    """Write a record as the table that the file has of it; `read_pair` reads it back."""
    finite = pair.dissimilarity if math.isfinite(pair.dissimilarity) else None
    table = asdict(pair) | {"dissimilarity": finite}
    for name in ("decision", "images", "mean_dissimilarity"):
        if table[name] is None:
            del table[name]
    return table


def read_pair(pair: Record) -> PairRecord:
    """Read a record, value by value.

    Raises:
        InputError: If a value is missing or is none that it can be.
    """
    found = PairRecord(
        query=pair.text("query"),
        database=pair.text("database"),
        num_inliers=pair.count("num_inliers", MOST_INLIERS),
        score=pair.number("score"),
        dissimilarity=math.inf
        if pair.get("dissimilarity") is None
        else pair.number("dissimilarity", 0.0),
        overlap_area=pair.number("overlap_area", 0.0),
        accepted=pair.flag("accepted"),
        reason=pair.text("reason"),
        T_database_query=None
        if pair.get("T_database_query") is None
        else _read_motion(pair.record("T_database_query")),
        z_offset=pair.optional_number("z_offset"),
        covariance=_read_covariance(pair),
        z_std=pair.optional_number("z_std", 0.0),
        scale=pair.optional_number("scale", 0.0),
        agreement=None
        if pair.values.get("agreement") is None
        else _read_agreement(pair.record("agreement")),
        decision=None
        if pair.values.get("decision") is None
        else read_decision(pair.record("decision")),
        images=None if pair.values.get("images") is None else _read_images(pair.record("images")),
        mean_dissimilarity=pair.optional_number("mean_dissimilarity", 0.0),
    )
    if found.query == found.database:
        raise pair.wrong("database", "another submap than the query")
    if found.is_confirmed and found.T_database_query is None:
        raise InputError(
            f"{pair.where}: 'decision' accepts the pair, but it has no motion, T_database_query"
        )
    return found


def read_decision(decision: Record) -> Decision:
    """Read what a person decided.

    Raises:
        InputError: If a value is none that it can be.
    """
    accepted = None if decision.values.get("accepted") is None else decision.flag("accepted")
    note = "" if decision.values.get("note") is None else decision.text("note")
    if len(note) > LONGEST_NOTE or not note.isprintable():
        raise decision.wrong("note", f"one line of at most {LONGEST_NOTE} letters")
    return Decision(accepted, note)


def _read_images(images: Record) -> ImageVerdict:
    verdict = images.text("verdict")
    if verdict not in get_args(ImageSays):
        raise images.wrong("verdict", f"one of {', '.join(get_args(ImageSays))}")
    counts = (images.count(name, MOST_INLIERS) for name in ("num_associations", "num_inliers"))
    return ImageVerdict(cast("ImageSays", verdict), images.text("reason"), *counts)


def count_images(verdicts: Iterable[ImageVerdict | None]) -> str:
    """Count what images say of pairs, in words; an empty text if none were asked.

    >>> count_images([ImageVerdict("silent", "too dark", 0, 0), None])
    'images: 0 confirmed, 0 contradicted, 1 silent'
    """
    found = [one.verdict for one in verdicts if one is not None]
    if not found:
        return ""
    return "images: " + ", ".join(f"{found.count(word):,} {word}" for word in get_args(ImageSays))


def _read_motion(motion: Record) -> SE2:
    x, y = (motion.number(key, -MAX_COORDINATE, MAX_COORDINATE) for key in "xy")
    return SE2(x, y, motion.number("yaw", -MAX_YAW, MAX_YAW))


def _read_agreement(agreement: Record) -> Agreement:
    return Agreement(*(agreement.number(one.name, 0.0) for one in fields(Agreement)))


def _usable(covariance: Float[Array, "3 3"] | None) -> Float[Array, "3 3"] | None:
    """Make a covariance exactly symmetric; None if it is not positive definite."""
    if covariance is None or not np.isfinite(covariance).all():
        return None
    symmetric = 0.5 * (covariance + covariance.T)
    return symmetric if np.linalg.eigvalsh(symmetric)[0] > 0 else None


def _read_covariance(pair: Record) -> tuple[tuple[float, ...], ...] | None:
    """Check a covariance that any tool may have written; with a bad one no graph can be solved."""
    key = "covariance"
    rows = cast("list[list[float]] | None", pair.values.get(key))
    if rows is None:
        return None
    if not _is_square(rows):
        raise pair.wrong(key, "three rows of three finite numbers (a covariance must be 3 x 3)")
    matrix = np.array(rows, dtype=np.float64)
    # Sums in single precision leave the two halves of a matrix equal to six digits only.
    if np.abs(matrix - matrix.T).max() > 1e-5 * np.abs(matrix).max():
        raise InputError(f"{pair.where}: a covariance must be symmetric")
    matrix = 0.5 * (matrix + matrix.T)
    if not np.linalg.eigvalsh(matrix)[0] > 0:
        raise InputError(f"{pair.where}: a covariance must be positive definite")
    return tuple(tuple(row) for row in matrix.tolist())


def _is_square(rows: object) -> bool:
    """Say whether a value of a JSON file is three rows of three numbers that can be squared."""
    if not isinstance(rows, list) or len(cast("list[object]", rows)) != 3:
        return False
    return all(
        isinstance(row, list)
        and len(cast("list[object]", row)) == 3
        and all(
            is_number(value) and abs(cast("float", value)) <= MAX_COVARIANCE
            for value in cast("list[object]", row)
        )
        for row in cast("list[object]", rows)
    )


def _rounded(value: float) -> float:
    """Round to nine digits, a nanometre in a metre; further digits are arithmetic noise."""
    return float(f"{value:z.9g}")
