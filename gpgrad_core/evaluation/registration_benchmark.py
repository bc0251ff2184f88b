"""The problems of the point clouds registration benchmark, and how methods solve them.

The benchmark of Fontana et al. (*A Benchmark for Point Clouds Registration Algorithms*,
arXiv:2003.12841, 2020) lists its problems in text files, ``NAME_global.txt`` and
``NAME_local.txt``. The README of iralabdisco/point_clouds_registration_benchmark gives the columns
``id source target overlap t1 … t12``, where t1 to t12 are the upper three rows of the motion by
which the source was misplaced. The files of that repository, which were read for this module, have
one more column, ``scale``, before t1, and name the columns in their first row. Both forms are read.
The error of a solution is that of ``metric.py`` there: the mean over the source's points p, with
centroid c, of ``|p_found - p_true| / |p_true - c|``.
"""

import re
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from gpgrad_core.errors import InputError
from gpgrad_core.evaluation.judge import Evaluation
from gpgrad_core.evaluation.report import TEMPLATES, Section, cell, render
from gpgrad_core.io.poses import pose_of_matrix
from gpgrad_core.reading.text import lines_of, parse_numbers, read_text
from gpgrad_core.se2 import Pose
from gpgrad_core.types import Array, Dataset

LARGEST = 50_000_000
"""Bytes of a file of problems; a row takes 300."""
FIRST = ("id", "source", "target", "overlap")
NUMBERS = tuple(f"t{k}" for k in range(1, 13))
FORMS = ((*FIRST, *NUMBERS), (*FIRST, "scale", *NUMBERS))


@dataclass(frozen=True, eq=False)
class BenchmarkProblem:
    """One pair of clouds of the benchmark."""

    id: str  # the benchmark's number of it, as text
    source: str  # name of the cloud that is to be placed, without its ending
    target: str  # name of the cloud on which it is to be placed, without its ending
    overlap: float  # share of the source that overlaps the target, as the file says
    misplacement: Pose  # the motion by which the benchmark misplaces the source in the world


def read_problems(path: Path) -> tuple[BenchmarkProblem, ...]:
    """Read a file of the benchmark's problems; its first row may name the columns."""
    if not path.exists():
        raise InputError(f"{path}: no such file")
    problems: list[BenchmarkProblem] = []
    width = 0
    for number, line in enumerate(lines_of(read_text(path, LARGEST)), start=1):
        words = line.split()
        if not words or line.startswith("#"):
            continue
        where = f"{path}, line {number}"
        if not width and words[0] == "id" and tuple(words) not in FORMS:
            raise InputError(
                f"{where}: names other columns than id source target overlap scale t1 … t12"
            )
        if width and len(words) != width:
            raise InputError(f"{where}: has {len(words)} columns, the rows before it have {width}")
        if len(words) not in map(len, FORMS):
            raise InputError(
                f"{where}: has {len(words)} columns; a problem has 16, id source target overlap t1 "
                "… t12, or 17 with scale before t1"
            )
        width = len(words)
        if words[0] != "id":
            problems.append(_problem(words, where))
    if not problems:
        raise InputError(f"{path}: holds no problems of the registration benchmark")
    return tuple(problems)


def _problem(words: list[str], where: str) -> BenchmarkProblem:
    (overlap,) = parse_numbers(words[3:4], where)
    if not 0.0 <= overlap <= 100.0:
        raise InputError(f"{where}: the overlap must be from 0 to 1, or to 100 %, got {words[3]}")
    parse_numbers(words[4:-12], where)
    matrix = np.array(parse_numbers(words[-12:], where)).reshape(3, 4)
    source, target = (re.sub(r"\.[A-Za-z]\w*$", "", name) for name in words[1:3])
    if source == target:
        raise InputError(f"{where}: places the cloud {source} on itself")
    return BenchmarkProblem(words[0], source, target, overlap, pose_of_matrix(matrix, where))


def check_problems(problems: Sequence[BenchmarkProblem], dataset: Dataset, path: Path) -> None:
    """Check before the work that a dataset has clouds of the problems."""
    placed = dataset.true_poses.keys()
    if not any({problem.source, problem.target} <= placed for problem in problems):
        raise InputError(
            f"{path}: none of its {len(problems):,} problems has both clouds, such as "
            f"{problems[0].source} and {problems[0].target}, with true poses in {dataset.name}"
        )


def describe_problems(
    problems: Sequence[BenchmarkProblem], dataset: Dataset, evaluation: Evaluation, path: Path
) -> Section:
    """Judge how methods solve the benchmark's problems, as a section of the report."""
    submaps = {submap.id: submap for submap in dataset.submaps}
    pairs = evaluation.pairs
    judged: list[_JudgedProblem] = []
    for problem in problems:
        row = pairs.rows.get(frozenset((problem.source, problem.target)))
        if row is None:
            continue
        source, target = submaps[problem.source], submaps[problem.target]
        assert source.pose_true is not None  # as of all submaps of a pair that is judged
        assert target.pose_true is not None
        true = source.pose_true.apply(source.points)
        ahead = pairs.ids[pairs.query[row]] == source.id
        solutions: dict[str, _Solution] = {}
        for method in evaluation.methods:
            motion, error = method.ranking.T_database_query[row], None
            if motion is not None:
                T_world_source = target.pose_true.planar @ (motion if ahead else motion.inverse())
                error = _error(true, T_world_source.apply(source.points[:, :2]))
            solutions[method.name] = _Solution(
                accepted=bool(method.ranking.accepted[row]),
                right=bool(method.errors.near[row]),
                error=error,
            )
        misplaced = _error(true, problem.misplacement.apply(true))
        judged.append(
            _JudgedProblem(problem.id, source.id, target.id, problem.overlap, misplaced, solutions)
        )
    content = {
        "file": path.name,
        "problems": len(problems),
        "held": len(judged),
        "pairs": [asdict(pair) for pair in judged],
    }
    text = render(
        TEMPLATES / "registration_benchmark.md",
        judged=judged,
        num_problems=len(problems),
        file=path.name,
        params=evaluation.params,
        methods={
            method.name: [pair.methods[method.name] for pair in judged]
            for method in evaluation.methods
        },
        median=_median,
        cell=cell,
    )
    return Section("registration_benchmark", content, text)


@dataclass(frozen=True)
class _Solution:
    """How a method solved a problem; the error is None if it gave no motion."""

    accepted: bool
    right: bool
    error: float | None


@dataclass(frozen=True)
class _JudgedProblem:
    """A problem of which the dataset has both clouds, and its solutions by method."""

    id: str
    source: str
    target: str
    overlap: float
    error_misplaced: float
    methods: dict[str, _Solution]


def _error(true: Float[Array, "n 3"], estimated: Float[Array, "n k"]) -> float:
    """The benchmark's error of points in space, or of x and y alone, by the true ones [m]."""
    distances = np.linalg.norm(estimated - true[:, : estimated.shape[1]], axis=1)
    weights = np.linalg.norm(true - true.mean(axis=0), axis=1)
    return float(np.mean(distances / np.maximum(weights, 1e-9)))


def _median(errors: Iterable[float | None]) -> str:
    """Write the median; no error, None, is above all others."""
    values = [np.inf if error is None else error for error in errors]
    # The value above, because between a number and infinity there is no middle.
    middle = float(np.quantile(values, 0.5, method="higher"))
    return f"{middle:.3g}" if np.isfinite(middle) else "none found"
