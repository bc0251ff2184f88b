"""Keypoints and associations -> points and lines of the scene."""

from dataclasses import dataclass
from typing import Literal, TypeAlias, get_args

import numpy as np
from jaxtyping import Bool, Float, Int

from app.viewer.scene.colors import INK, INLIER, OUTLIER, PAPER, REFUSED_INLIER, Rgb
from app.viewer.scene.placement import Placement
from app.viewer.session.state import ViewOptions
from gpgrad_core.arrays import Array, NDArray
from gpgrad_core.detection import PairResult
from gpgrad_core.types import GradientMap

ARC_PIECES = 12
MOST_LINES = 24
"""Of inliers, and of outliers, unless all are requested."""
ARC_RISE, CHOSEN_RISE = 0.12, 0.2
"""Height of an arc over its span: of any, and of the one that is pointed at."""

Kind: TypeAlias = Literal["unmatched", "outlier", "inlier"]
"""What became of a keypoint."""
KINDS: tuple[Kind, ...] = get_args(Kind)


@dataclass(frozen=True)
class Mark:
    """How a keypoint is marked: a disc on a larger one, both of a constant size on the screen."""

    rim: Rgb
    rim_width: float  # [pixels]
    core: Rgb
    core_width: float  # [pixels]


@dataclass(frozen=True, eq=False)
class Dots:
    """Marked positions in a submap's frame."""

    points: Float[Array, "n 3"]  # [m]
    kinds: Int[NDArray[np.intp], "n"]  # places in `KINDS`


def on_surface(
    gradient_map: GradientMap, positions: Float[Array, "n 2"], lift: float = 0.0
) -> Float[Array, "n 3"]:
    """Positions [m] at the height of the nearest cell, plus a lift [m] out of the ground."""
    row, column, _ = gradient_map.grid.nearest_cells(positions)
    return np.column_stack([positions, gradient_map.elevation[row, column] + lift])


def match_lines(
    result: PairResult,
    placements: tuple[Placement, Placement],
    inliers: bool,
    lift: float,
    everything: bool = True,
) -> Float[NDArray[np.float32], "n 2 3"]:
    """Join associated keypoints across the scene by arcs, which the ground does not hide.

    They are inliers or else outliers, and all of them or else those that `shown_matches` chooses.
    Their ends are so high above the ground [m]. An arc has `ARC_PIECES` straight pieces; those of
    outliers have gaps between them, so that they differ by more than their colour.
    """
    chosen = np.flatnonzero(shown_matches(result, inliers=inliers, everything=everything))
    if inliers:
        return arcs_of(result, placements, chosen, lift)
    return arcs_of(result, placements, chosen, lift, pieces=2 * ARC_PIECES)[::2]


def shown_matches(
    result: PairResult, *, inliers: bool, everything: bool
) -> Bool[NDArray[np.bool_], "m"]:
    """Choose the associations to draw: all, or `MOST_LINES` that are spread over the ground."""
    agree = result.registration.inliers
    kind = agree if inliers else ~agree
    if everything:
        return kind
    numbers = np.flatnonzero(kind)
    chosen = np.zeros(len(kind), dtype=bool)
    chosen[numbers[spread(result.matches.query_xy[numbers], MOST_LINES)]] = True
    return chosen


def spread(positions: Float[Array, "n 2"], most: int) -> Int[NDArray[np.intp], "k"]:
    """Choose positions [m], always the one farthest from those chosen, and give their indices."""
    if len(positions) <= most:
        return np.arange(len(positions))
    middle = positions.mean(axis=0)
    chosen = [int(np.argmax(np.linalg.norm(positions - middle, axis=1)))]
    nearest = np.full(len(positions), np.inf)
    while len(chosen) < most:
        distances = np.linalg.norm(positions - positions[chosen[-1]], axis=1)
        nearest = np.minimum(nearest, distances)
        chosen.append(int(np.argmax(nearest)))
    return np.unique(chosen)


def match_arc(
    result: PairResult, placements: tuple[Placement, Placement], index: int, lift: float
) -> Float[NDArray[np.float32], "n 2 3"]:
    """Join the keypoints of one association as `match_lines` joins many, above all these."""
    return arcs_of(result, placements, np.array([index]), lift, rise=CHOSEN_RISE)


def arcs_of(
    result: PairResult,
    placements: tuple[Placement, Placement],
    chosen: Int[NDArray[np.intp], "k"],
    lift: float,
    rise: float = ARC_RISE,
    pieces: int = ARC_PIECES,
) -> Float[NDArray[np.float32], "n 2 3"]:
    """Join the keypoints of the associations of these numbers, as `match_lines` does."""
    start, end = (
        placement.apply(on_surface(gradient_map, xy[chosen], lift))
        for placement, gradient_map, xy in zip(
            placements,
            result.maps,
            (result.matches.query_xy, result.matches.database_xy),
            strict=True,
        )
    )
    return arcs(start, end, pieces, rise)


def arcs(
    start: Float[Array, "n 3"], end: Float[Array, "n 3"], pieces: int, rise: float
) -> Float[NDArray[np.float32], "k 2 3"]:
    """Span arches of so many straight pieces between points, as high as a share of their span."""
    along = np.linspace(0.0, 1.0, pieces + 1)[None, :, None]
    points = start[:, None] * (1.0 - along) + end[:, None] * along
    span = np.linalg.norm((end - start)[:, :2], axis=1)
    points[..., 2] += (4.0 * rise * span)[:, None] * (along * (1.0 - along))[..., 0]
    return np.stack([points[:, :-1], points[:, 1:]], axis=2).reshape(-1, 2, 3).astype(np.float32)


def shown_kinds(options: ViewOptions) -> tuple[Kind, ...]:
    """Name the kinds of keypoints that are marked."""
    return tuple(
        kind
        for kind in KINDS
        if (options.keypoints if kind == "inlier" else options.other_keypoints)
    )


def keypoint_dots(
    result: PairResult, index: int, *, lift: float, shown: tuple[Kind, ...] = KINDS
) -> Dots:
    """Mark keypoints of some kinds of the query (0) or the database (1), so far above it [m]."""
    kinds = keypoint_kinds(result, index)
    chosen = np.isin(kinds, [KINDS.index(kind) for kind in shown])
    points = on_surface(result.maps[index], result.features[index].positions[chosen], lift)
    return Dots(points, kinds[chosen])


def keypoint_kinds(result: PairResult, index: int) -> Int[NDArray[np.intp], "k"]:
    """The index in `KINDS` of each keypoint of the query (0) or the database (1)."""
    kinds = np.full(len(result.features[index]), KINDS.index("unmatched"))
    indices = result.matches.pairs[:, index]
    agree = result.registration.inliers
    # Inliers last: without the mutual check a keypoint may have several partners.
    kinds[indices[~agree]] = KINDS.index("outlier")
    kinds[indices[agree]] = KINDS.index("inlier")
    return kinds


def mark_of(kind: Kind, inliers: Rgb = INLIER) -> Mark:
    """The mark of a kind: an inlier is bright in a dark rim, an outlier dark in a bright one.

    Any other's is small. So they differ by light and by size; their colours only repeat
    that. Marks of one size are shown together, see `MarksNode`.
    """
    match kind:
        case "inlier":
            return Mark(INK, 4.8, inliers, 3.3)
        case "outlier":
            return Mark(PAPER, 4.8, OUTLIER, 3.3)
        case "unmatched":
            return Mark(INK, 2.3, PAPER, 1.2)


def shown_counts(result: PairResult, options: ViewOptions) -> dict[Kind, int]:
    """Count what is marked: associations of each kind, and keypoints of both maps without one."""
    inliers, total = result.registration.num_inliers, len(result.matches)
    alone = sum(
        len(of_map) - len(np.unique(indices))
        for of_map, indices in zip(result.features, result.matches.pairs.T, strict=True)
    )
    counts = {"inlier": inliers, "outlier": total - inliers, "unmatched": alone}
    return {kind: counts[kind] for kind in shown_kinds(options)}


def inlier_color(result: PairResult) -> Rgb:
    """The colour of inliers: green, or yellow where there are too few to close the loop."""
    return INLIER if result.closure.accepted else REFUSED_INLIER


def residuals(result: PairResult) -> Float[Array, "m"] | None:
    """The residual of each association under the motion [m]; None without a motion."""
    motion = result.registration.T_database_query
    if motion is None:
        return None
    missed = motion.apply(result.matches.query_xy) - result.matches.database_xy
    return np.hypot(missed[:, 0], missed[:, 1])


def describe_match(result: PairResult, index: int) -> tuple[Kind, float | None]:
    """Whether an association is an inlier, and its residual [m], if there is a motion."""
    missed = residuals(result)
    kind: Kind = "inlier" if result.registration.inliers[index] else "outlier"
    return kind, None if missed is None else float(missed[index])


def step_match(result: PairResult, number: int, step: int, *, inliers: bool, outliers: bool) -> int:
    """The number, from 1, of the next (1) or previous (-1) association of the selected kinds.

    It wraps around; 0 is before the first, and stands for none. Where there is none of
    these kinds, as of inliers where nothing fits, any will do.
    """
    agree = result.registration.inliers
    wanted = agree & inliers | ~agree & outliers
    numbers = np.flatnonzero(wanted if wanted.any() else agree | ~agree) + 1
    if len(numbers) == 0:
        return 0
    beyond = numbers[numbers > number] if step > 0 else numbers[numbers < number][::-1]
    return int(beyond[0]) if len(beyond) else int(numbers[0 if step > 0 else -1])


def outline(corners: Float[Array, "k 3"]) -> Float[NDArray[np.float32], "k 2 3"]:
    """Close a polygon: each corner joined to the next."""
    return np.stack([corners, np.roll(corners, -1, axis=0)], axis=1).astype(np.float32)
