"""``closures.json``: the verdict on every pair of submaps, and how it was reached."""

import json
import math
from collections.abc import Mapping
from dataclasses import asdict, astuple, dataclass
from pathlib import Path
from typing import Any, cast

import cv2
import numpy as np
from jaxtyping import Float

from gpgrad_core.errors import InputError
from gpgrad_core.outputs.files import replacing
from gpgrad_core.pipeline import DetectionResult, PipelineParams
from gpgrad_core.se2 import SE2
from gpgrad_core.types import Agreement, Array, Dataset, LoopClosure, Registration
from gpgrad_core.version import VERSION


@dataclass(frozen=True)
class PairRecord:
    """One pair of submaps in the file.

    Attributes:
        query: Id of the later submap.
        database: Id of the earlier one.
        num_inliers: Number of associations that agree with the motion.
        score: A pair with a higher score is more likely a loop closure.
        dissimilarity: The paper's SSD metric h; infinite if the maps were not compared.
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
        pairs: Every unordered pair once.
    """

    dataset: str
    method: str
    seed: int
    params: Mapping[str, Any]
    versions: Mapping[str, str]
    seconds: Mapping[str, float]
    submaps: Mapping[str, int]
    pairs: tuple[PairRecord, ...]

    @property
    def accepted(self) -> tuple[PairRecord, ...]:
        """The loop closures."""
        return tuple(pair for pair in self.pairs if pair.accepted)


def report_closures(
    dataset: Dataset, result: DetectionResult, params: PipelineParams, *, method: str = "gradient"
) -> ClosureReport:
    """Make the content of the file from a detection.

    Args:
        dataset: The dataset that was searched.
        result: The result of the detection. If it has the values of automatic parameters, the
            file has these.
        params: The parameters of the detection.
        method: The name of the method.

    Returns:
        The content of ``closures.json``.
    """
    params = result.params or params
    return ClosureReport(
        dataset=dataset.name,
        method=method,
        seed=params.registration.seed,
        params=asdict(params),
        versions={"gpgrad": VERSION, "numpy": np.__version__, "opencv": cv2.__version__},
        seconds={stage: round(seconds, 3) for stage, seconds in result.seconds.items()},
        submaps={submap.id: len(submap.points) for submap in dataset.submaps},
        pairs=tuple(_record(closure) for closure in result.closures),
    )


def write_closures(path: Path | str, report: ClosureReport) -> None:
    """Write a report as JSON, completely or not at all.

    Args:
        path: The file.
        report: Its content, such as `report_closures` makes.

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
        "submaps": [{"id": name, "num_points": count} for name, count in report.submaps.items()],
        "pairs": [
            asdict(pair)
            | {"dissimilarity": pair.dissimilarity if math.isfinite(pair.dissimilarity) else None}
            for pair in report.pairs
        ],
    }
    with replacing(path) as unfinished:
        # NaN and Infinity are not JSON; an error here is better than one in a reader.
        text = json.dumps(content, indent=1, ensure_ascii=False, allow_nan=False)
        unfinished.write_text(text + "\n", encoding="utf-8")


def read_closures(path: Path | str) -> ClosureReport:
    """Read a file that `write_closures` wrote.

    Args:
        path: The file; any tool may have written it in the same format.

    Returns:
        Its content.

    Raises:
        InputError: If the file is not JSON or a key is missing; the message names file and key.
        OSError: If the file cannot be read.
    """
    path = Path(path)
    try:
        content = cast("dict[str, Any]", json.loads(path.read_text(encoding="utf-8")))
    except ValueError as error:
        raise InputError(f"{path}: not a JSON file: {error}") from error
    try:
        return ClosureReport(
            dataset=content["dataset"],
            method=content["method"],
            seed=content["seed"],
            params=content["params"],
            versions=content["versions"],
            seconds=content["seconds"],
            submaps={submap["id"]: submap["num_points"] for submap in content["submaps"]},
            pairs=tuple(_read_pair(pair) for pair in content["pairs"]),
        )
    except KeyError as error:
        raise InputError(f"{path}: not a file of loop closures: {error} is missing") from error
    except (TypeError, AttributeError) as error:
        raise InputError(f"{path}: not a file of loop closures: {error}") from error


def restore_closures(report: ClosureReport) -> tuple[LoopClosure, ...]:
    """Turn the content of a file back into loop closures, as far as possible.

    The file has the number of inliers, but not which associations they are, and it does not have
    the correlation.

    Args:
        report: The content of the file.

    Returns:
        The loop closures, accepted and refused, in the order of the file.
    """
    return tuple(_closure(pair) for pair in report.pairs)


def _closure(pair: PairRecord) -> LoopClosure:
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
    )
    return LoopClosure(pair.query, pair.database, registration, pair.accepted, pair.reason)


def _record(closure: LoopClosure) -> PairRecord:
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
    )


def _read_pair(pair: Mapping[str, Any]) -> PairRecord:
    h, motion = pair["dissimilarity"], pair["T_database_query"]
    agreement = pair.get("agreement")
    return PairRecord(
        query=pair["query"],
        database=pair["database"],
        num_inliers=pair["num_inliers"],
        score=pair["score"],
        dissimilarity=math.inf if h is None else h,
        overlap_area=pair["overlap_area"],
        accepted=pair["accepted"],
        reason=pair["reason"],
        T_database_query=motion and SE2(motion["x"], motion["y"], motion["yaw"]),
        z_offset=pair.get("z_offset"),
        covariance=_read_covariance(pair.get("covariance")),
        z_std=pair.get("z_std"),
        scale=pair.get("scale"),
        agreement=None if agreement is None else Agreement(**agreement),
    )


def _usable(covariance: Float[Array, "3 3"] | None) -> Float[Array, "3 3"] | None:
    """Make a covariance exactly symmetric; None if it is not positive definite."""
    if covariance is None or not np.isfinite(covariance).all():
        return None
    symmetric = 0.5 * (covariance + covariance.T)
    return symmetric if np.linalg.eigvalsh(symmetric)[0] > 0 else None


def _read_covariance(rows: object) -> tuple[tuple[float, ...], ...] | None:
    """Check a covariance that any tool may have written; with a bad one no graph can be solved."""
    if rows is None:
        return None
    matrix = np.asarray(rows, dtype=np.float64)
    if matrix.shape != (3, 3) or not np.isfinite(matrix).all():
        raise TypeError("a covariance must be three rows of three numbers")
    # Sums in single precision leave the two halves of a matrix equal to six digits only.
    if np.abs(matrix - matrix.T).max() > 1e-5 * np.abs(matrix).max():
        raise TypeError("a covariance must be symmetric")
    matrix = 0.5 * (matrix + matrix.T)
    if np.linalg.eigvalsh(matrix)[0] <= 0:
        raise TypeError("a covariance must be positive definite")
    return tuple(tuple(row) for row in matrix.tolist())


def _rounded(value: float) -> float:
    """Round to nine digits, a nanometre in a metre; further digits are arithmetic noise."""
    return float(f"{value:.9g}")
