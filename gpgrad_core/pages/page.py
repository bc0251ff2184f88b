"""The page of a dataset: maps, scores and every accepted pair, in one file that asks no server."""

import base64
import json
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from math import ceil, degrees, sqrt
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float
from numpy.typing import DTypeLike

from gpgrad_core import __version__
from gpgrad_core.arrays import Array, Mask, NDArray
from gpgrad_core.detection import (
    PairResult,
    PipelineParams,
    infer_features,
    infer_map,
    resolve_parameters,
)
from gpgrad_core.detection.choosing import likely
from gpgrad_core.errors import score_in_words
from gpgrad_core.evaluation import Evaluation
from gpgrad_core.evaluation.report import render
from gpgrad_core.io.records.closures import ClosureReport, restore_closures, rounded
from gpgrad_core.io.records.files import replacing
from gpgrad_core.mapping.fitting import representative
from gpgrad_core.matching import match_features
from gpgrad_core.pages.subject import PageData
from gpgrad_core.params import parameters_in_words
from gpgrad_core.registration.candidates import one_to_one
from gpgrad_core.run import Progress, silent
from gpgrad_core.run.memo import Memo
from gpgrad_core.se2 import FAR, SE2, Pose
from gpgrad_core.slam.coordinates import level_motion
from gpgrad_core.slam.errors import positions
from gpgrad_core.slam.graph import shifted
from gpgrad_core.types import Features, GradientMap, LoopClosure

PAGE = "page.html"
"""Name of the page in a folder of results."""
FOLDER = Path(__file__).parent
MOST_CELLS = 4_500_000
"""Of all terrain together: about 7 MB of a page."""
MOST_ALONG = 160
"""Cells along a side of one submap."""
MOST_HELD = 300_000_000
"""Bytes of maps that are held at a time; each is needed once."""
MOST_LINED = 1000
"""Number of pairs, the best first, whose keypoints the page has."""

FINEST = 0.0005
"""Smallest step of a packed height [m]: half a millimetre, far below what points tell."""
LARGEST = 2**15 - 1
"""Number of steps that a height may span."""
ACCEPTED, BARRED, TRUE, FALSE, RIGHT, DROPPED, CONFIRMED = 1, 2, 4, 8, 16, 32, 64
"""What is known of a pair, as bits: accepted; refused for another reason than its score; true and
false by the first rule of the evaluation; its motion is right; refused by the pose graph;
a person has accepted it, whatever its score."""


@dataclass(frozen=True, eq=False)
class Pack:
    """Named arrays, one after the other, which a browser unpacks by itself: deflated, in base64."""

    arrays: list[bytes] = field(default_factory=list[bytes])
    # name, type, and number of bytes of each array
    index: list[tuple[str, str, int]] = field(default_factory=list[tuple[str, str, int]])

    def add(self, name: str, array: NDArray[np.generic]) -> None:
        # Each begins at a multiple of four bytes, as the typed arrays of a browser must.
        raw = array.astype(array.dtype.newbyteorder("<")).tobytes()
        self.arrays.append(raw + bytes(-len(raw) % 4))
        self.index.append((name, array.dtype.name, len(raw)))

    @property
    def text(self) -> str:
        return base64.b64encode(zlib.compress(b"".join(self.arrays), 9)).decode("ascii")


@dataclass(frozen=True, eq=False)
class Packed:
    """The terrain of one submap, fit to be packed."""

    base: float  # lowest height [m]
    step: float  # of a height [m]
    # differences of the heights along each row, as whole steps; the low bytes of all cells, and
    # then the high ones, because these are nearly all alike
    deltas: NDArray[np.uint8]
    trusted: NDArray[np.uint8]  # which cells are trusted, a bit for each


def pack_terrain(
    elevation: Float[Array, "rows columns"], mask: Bool[Mask, "rows columns"]
) -> Packed:
    """Make the heights [m] of a submap small: whole steps, and differences from cell to cell."""
    trusted = elevation[mask]
    low, high = (float(trusted.min()), float(trusted.max())) if mask.any() else (0.0, 0.0)
    step = max(FINEST, (high - low) / LARGEST)
    steps = np.rint((np.clip(elevation, low, high) - low) / step).astype(np.int32)
    # Where nothing is known the last known height goes on, which costs nothing.
    last = np.maximum.accumulate(np.where(mask, np.arange(steps.shape[1]), 0), axis=1)
    steps = np.take_along_axis(steps, last, axis=1)
    deltas = np.diff(steps, axis=1, prepend=0).ravel()
    # Small ones of both signs become small numbers.
    folded = ((deltas << 1) ^ (deltas >> 31)).astype(np.uint16)
    planes = np.concatenate([folded & 0xFF, folded >> 8]).astype(np.uint8)
    return Packed(low, step, planes, np.packbits(mask.ravel(), bitorder="little"))


def write_page(
    path: Path, subject: PageData, memo: Memo | None = None, progress: Progress = silent
) -> None:
    """Write the page of a dataset, whole or not at all, with maps from the memo or its store."""
    page = page_of_dataset(subject, memo, progress)
    with replacing(path) as unfinished:
        unfinished.write_text(page, encoding="utf-8")


def page_of_dataset(
    subject: PageData, memo: Memo | None = None, progress: Progress = silent
) -> str:
    """Make the page of a dataset, as `write_page` writes it."""
    report, loaders = subject.report, subject.loaders
    memo = memo or Memo(MOST_HELD)
    params = _with_numbers(subject, memo)
    number = {name: k for k, name in enumerate(loaders)}
    threshold = _threshold(report, params)
    ranked = likely(report.accepted)
    pack, listed = Pack(), ranked[:MOST_LINED]
    named = {name for closure in listed for name in closure.pair}
    features: dict[str, Features] = {}
    cells: list[dict[str, object]] = []
    centres: dict[str, Array] = {}
    side = 0.0
    for k, load in enumerate(loaders.values()):
        submap = load()
        terrain = infer_map(submap, params, memo)
        if not side:  # the first submap stands for the others
            height, width = (terrain.grid.resolution * count for count in terrain.grid.shape)
            side = max(sqrt(len(loaders) * height * width / MOST_CELLS), 0.0)
        centre = centres[submap.id] = submap.centre
        cells.append(_add_terrain(pack, terrain, params.features.max_std_ratio, side, centre))
        if submap.id in named and report.method == "gradient":
            features[submap.id] = infer_features(submap, params, memo)
        progress(0.9 * (k + 1) / len(loaders))
    lines = {
        closure.pair: _centred(line, *(centres[name] for name in closure.pair))
        for closure in listed
        if (line := _inliers(closure, features, params)) is not None
    }
    _add_pairs(pack, subject, number, threshold)
    content = {
        "name": subject.name,
        "method": report.method,
        "threshold": threshold,
        "submaps": [
            {"id": name, "starts": k == 0 or name in subject.starts, **cells[k]}
            for name, k in number.items()
        ],
        "poses": _poses(subject, cells, centres),
        "curve": None if subject.evaluation is None else _curve(subject.evaluation),
        "skipped": report.num_pairs_skipped,
        "reasons": _reasons(report, number),
        "lines": [
            [number[query], number[database], _add_line(pack, k, line)]
            for k, ((query, database), line) in enumerate(lines.items())
        ],
        "arrays": pack.index,
    }
    progress(0.95)
    page = _filled(
        subject.name, content, pack, subject, parameters_in_words(params, params, PipelineParams())
    )
    progress(1.0)
    return page


def page_of_pair(
    result: PairResult, *, max_std_ratio: float = PipelineParams().features.max_std_ratio
) -> str:
    """Make the page of one pair: both surfaces at the motion that was found, and the inliers."""
    closure = rounded(result.closure)
    pack = Pack()
    maps = (result.database_map, result.query_map)
    ids = (closure.database_id, closure.query_id)
    centres = [_middle(terrain) for terrain in maps]
    cells = [
        _add_terrain(pack, terrain, max_std_ratio, 0.0, centre)
        for terrain, centre in zip(maps, centres, strict=True)
    ]
    report = ClosureReport(
        dataset=f"{closure.query_id} onto {closure.database_id}",
        method="gradient",
        seed=0,
        params={},
        versions={},
        seconds={},
        submaps=dict.fromkeys(ids, 0),
        pairs=(closure,),
    )
    score = closure.registration.score
    threshold = score if closure.accepted else np.nextafter(score, np.inf)
    subject = PageData(report.dataset, {}, report, PipelineParams(), figures=_pair_figures(closure))
    _add_pairs(pack, subject, {ids[0]: 0, ids[1]: 1}, float(threshold))
    lines: list[list[int]] = []
    if result.registration.num_inliers:
        inliers, matches = result.registration.inliers, result.matches
        both = np.hstack([matches.query_xy[inliers], matches.database_xy[inliers]])
        lines = [[1, 0, _add_line(pack, 0, _centred(both, *centres[::-1]))]]
    content = {
        "name": report.dataset,
        "method": "",
        "threshold": float(threshold),
        "submaps": [{"id": ids[k], "starts": True, **cells[k]} for k in (0, 1)],
        "poses": None,
        "curve": None,
        "skipped": 0,
        "reasons": [[1, 0, closure.reason]],
        "lines": lines,
        "arrays": pack.index,
    }
    return _filled(report.dataset, content, pack, subject, [])


def _filled(
    title: str,
    content: Mapping[str, object],
    pack: Pack,
    subject: PageData,
    parameters: Sequence[tuple[str, str, bool]],
) -> str:
    # A text that ends the script's element would end the page; the browser reads \u003c as <.
    text = json.dumps(content, ensure_ascii=False, allow_nan=False, separators=(",", ":"))
    return render(
        FOLDER / "page.html",
        title=title,
        content=text.replace("<", "\\u003c"),
        arrays=pack.text,
        style=(FOLDER / "page.css").read_text(encoding="utf-8"),
        script=(FOLDER / "page.js").read_text(encoding="utf-8"),
        figures=subject.figures,
        commands=subject.commands,
        notes=subject.notes,
        parameters=parameters,
        method=subject.report.method,
        whole=content["poses"] is not None,
        judged=content["curve"] is not None,
        corrected=subject.after is not None,
        version=__version__,
    )


def _with_numbers(subject: PageData, memo: Memo) -> PipelineParams:
    loaders = [*subject.loaders.values()]
    if subject.params.map.has_numbers or not loaders:
        return subject.params
    some = [loaders[k]() for k in representative(len(loaders))]
    return resolve_parameters(some, subject.params, memo)


def _threshold(report: ClosureReport, params: PipelineParams) -> float:
    """Lowest score of acceptance: that of an accepted pair, where a method has no limit."""
    undecided = [closure for closure in report.pairs if closure.pair not in report.decisions]
    lowest = min((one.registration.score for one in undecided if one.accepted), default=np.inf)
    return float(min(params.closure.min_score, lowest))


def _add_terrain(
    pack: Pack,
    terrain: GradientMap,
    max_std_ratio: float,
    side: float,
    centre: Float[Array, "3"],
) -> dict[str, object]:
    """Pack every n-th cell, at least `side` [m] wide, about a centre: browsers have 7 digits."""
    grid = terrain.grid
    every = max(ceil(side / grid.resolution - 0.01), ceil(max(grid.shape) / MOST_ALONG), 1)
    heights = terrain.elevation[::every, ::every]
    packed = pack_terrain(heights, terrain.trusted(max_std_ratio, every))
    rows, columns = heights.shape
    pack.add("heights", packed.deltas)
    pack.add("known", packed.trusted)
    return {
        "centre": centre.tolist(),
        "x": round(float(grid.origin[0] - centre[0]), 4),
        "y": round(float(grid.origin[1] - centre[1]), 4),
        "cell": grid.resolution * every,
        "rows": rows,
        "columns": columns,
        "base": packed.base - float(centre[2]),
        "step": packed.step,
    }


def _inliers(
    closure: LoopClosure, features: Mapping[str, Features], params: PipelineParams
) -> Float[Array, "n 4"] | None:
    """Find a pair's inliers again [m]; None if they are not those that the pair was judged by."""
    registration = closure.registration
    motion, scale = registration.T_database_query, registration.scale
    if motion is None or scale is None or {*closure.pair} - features.keys():
        return None
    query, database = (features[name] for name in closure.pair)
    matches = match_features(query, database, params.matching)
    inliers = one_to_one(motion, matches, params.registration.radius(scale))
    if (
        abs(int(inliers.sum()) - registration.num_inliers) > 1
    ):  # the file has nine digits of the motion
        return None
    return np.hstack([matches.query_xy[inliers], matches.database_xy[inliers]])


def _middle(terrain: GradientMap) -> Float[Array, "3"]:
    rows, columns = terrain.grid.shape
    place = terrain.grid.to_position(np.array([[columns - 1.0, rows - 1.0]]) / 2)[0]
    return np.array([*place, np.median(terrain.elevation)])


def _centred(
    line: Float[Array, "n 4"], query: Float[Array, "3"], database: Float[Array, "3"]
) -> Float[Array, "n 4"]:
    return line - np.concatenate([query[:2], database[:2]])


def _add_line(pack: Pack, number: int, line: Float[Array, "n 4"]) -> int:
    pack.add("line", line.astype(np.float32).ravel())
    return number


def _add_pairs(pack: Pack, subject: PageData, number: Mapping[str, int], threshold: float) -> None:
    """Pack all pairs, each as a number in each of these arrays."""
    report, dropped = subject.report, set(subject.dropped)
    registrations = [closure.registration for closure in report.pairs]
    indices: dict[frozenset[str], int] = {}
    if subject.evaluation is not None:
        indices = _labels(subject.evaluation)
    states: list[int] = []
    for judged, closure in zip(report.pairs, restore_closures(report), strict=True):
        decision = report.decisions.get(closure.pair)
        decided = None if decision is None else decision.accepted
        passes = judged.registration.score >= threshold
        barred = decided is False or (not judged.accepted and passes)
        states.append(
            ACCEPTED * closure.accepted
            | BARRED * (barred and not closure.accepted)
            | CONFIRMED * (decided is True)
            | DROPPED * (closure.pair in dropped)
            | indices.get(frozenset(closure.pair), 0)
        )
    motions = [one.T_database_query for one in registrations]
    unknown = SE2(np.nan, np.nan, np.nan)
    far = any(max(abs(motion.x), abs(motion.y)) > FAR for motion in motions if motion is not None)

    def numbers(name: str, values: Sequence[float | None], kind: DTypeLike = np.float32) -> None:
        pack.add(name, np.array([np.nan if v is None else v for v in values], kind))

    def counts(name: str, values: Sequence[int]) -> None:
        pack.add(name, np.minimum(np.array(values, np.int64), 65535).astype(np.uint16))

    counts("query", [number[closure.query_id] for closure in report.pairs])
    counts("database", [number[closure.database_id] for closure in report.pairs])
    counts("inliers", [one.num_inliers for one in registrations])
    pack.add("state", np.array(states, np.uint8))
    numbers("score", [one.score for one in registrations])
    numbers("area", [one.overlap_area for one in registrations])
    for name in ("x", "y", "yaw"):
        values = [getattr(motion or unknown, name) for motion in motions]
        numbers(name, values, np.float64 if far else np.float32)
    numbers("z", [None if one.covariance is None else one.z_offset for one in registrations])


def _labels(evaluation: Evaluation) -> dict[frozenset[str], int]:
    pairs, labels, errors = evaluation.pairs, evaluation.labels[0], evaluation.methods[0].errors
    bits = TRUE * labels.positive + FALSE * labels.negative + RIGHT * errors.near
    ends = zip(pairs.query, pairs.database, strict=True)
    return {
        frozenset((pairs.ids[query], pairs.ids[database])): int(value)
        for (query, database), value in zip(ends, bits, strict=True)
    }


def _curve(evaluation: Evaluation) -> dict[str, object]:
    ranked, rule = evaluation.methods[0].rules[0].ranked, evaluation.rules[0]
    return {
        "rule": rule.statement,
        "true": int(evaluation.labels[0].positive.sum()),
        "average": None if ranked is None else round(ranked.average_precision.value, 4),
        "full": None if ranked is None else round(ranked.recall_at_full_precision.value, 4),
    }


def _reasons(report: ClosureReport, number: Mapping[str, int]) -> list[list[object]]:
    """The reasons of the pairs that rank high, which a reader may open."""
    decided = zip(report.pairs, restore_closures(report), strict=True)
    ranked = sorted(decided, key=lambda both: (not both[1].accepted, -both[0].registration.score))
    return [
        [number[judged.query_id], number[judged.database_id], judged.reason]
        for judged, _ in ranked[: 2 * MOST_LINED]
    ]


def _poses(
    subject: PageData,
    cells: Sequence[Mapping[str, object]],
    centres: Mapping[str, Float[Array, "3"]],
) -> dict[str, object]:
    """List x, y, yaw and height of every submap's centre before and after, and of the truth."""

    def placed(poses: Mapping[str, Pose]) -> dict[str, Pose]:
        return {name: shifted(poses[name], centres[name]) for name in ids if name in poses}

    ids = [*subject.loaders]
    posed = {name for name in ids if name in subject.before}
    before, true = placed(subject.before), placed(subject.truth)
    if len(posed) < len(ids):  # those without a pose stand in rows beside the others
        wide = max(float(str(cell["cell"])) * int(str(cell["columns"])) for cell in cells) + 1.0
        across = ceil(sqrt(len(ids)))
        right = max((pose.translation[0] for pose in before.values()), default=0.0)
        for k, name in enumerate(name for name in ids if name not in posed):
            place = SE2(float(right) + wide * (1 + k % across), wide * (k // across), 0.0)
            before[name] = Pose.from_planar(place)
    after = None if subject.after is None else placed(subject.after)
    reference = before if after is None else after
    shared = [name for name in ids if name in true and name in reference]
    truth: list[list[float] | None] | None = None
    if posed and len(shared) >= 2:
        motion = level_motion(positions(shared, true), positions(shared, reference))
        truth = [_row(motion @ true[name]) if name in true else None for name in ids]
    return {
        "known": bool(posed),
        "before": [_row(before[name]) for name in ids],
        "after": None if after is None else [_row(after[name]) for name in ids],
        "truth": truth,
    }


def _row(pose: Pose) -> list[float]:
    planar: SE2 = pose.planar
    values: NDArray[np.float64] = np.array(
        [planar.x, planar.y, planar.yaw, float(pose.translation[2])]
    )
    return [round(float(value), 5) for value in values]


def _pair_figures(closure: LoopClosure) -> list[tuple[str, str]]:
    registration = closure.registration
    figures = [
        ("verdict", "loop closure" if closure.accepted else "no loop closure"),
        ("score", score_in_words(registration.score)),
        ("inliers", f"{registration.num_inliers:,}"),
    ]
    if (motion := registration.T_database_query) is not None:
        figures += [
            ("offset", f"{motion.x:+.2f} m, {motion.y:+.2f} m"),
            ("turn", f"{degrees(motion.yaw):+.1f}°"),
        ]
    return figures
