"""Solves a pose graph by graduated non-convexity with GTSAM, which refuses wrong closures."""

import contextlib
from collections.abc import Generator, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, cached_property
from types import ModuleType
from typing import TYPE_CHECKING, Annotated, TypeAlias

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation
from typing_extensions import Doc

from gpgrad_core.errors import InputError
from gpgrad_core.libraries import load_library
from gpgrad_core.params import Bounds, check_bounds
from gpgrad_core.run import Progress, silent
from gpgrad_core.run.threads import single_threaded_libraries
from gpgrad_core.se2 import Pose
from gpgrad_core.slam.graph import Anchor, Centres, Edge, PoseGraph
from gpgrad_core.types import Array, read_only

if TYPE_CHECKING:
    import gtsam

    _Factor: TypeAlias = gtsam.BetweenFactorPose3 | gtsam.PriorFactorPose3
    _Felt: TypeAlias = tuple[Pose, gtsam.Pose3, gtsam.AttitudeFactorPose3]

GROWTH = 2.0
"""Factor by which the sharpness grows in each round; 1.4 finds the same in twice the time."""
STEPS_A_ROUND = 2
"""Levenberg-Marquardt steps in a round; the next round changes the weights, so more are wasted."""
MOST_ROUNDS = 80
FIRST_STD = 1e-4
"""Standard deviation of the first pose, which is held fixed [m, rad]."""
LOOSE_STD = 1e3
"""Standard deviation of the start of every other traverse, and of what an anchor does not measure
[m, rad]; it keeps the problem solvable if all closures of a traverse are refused."""
ANCHORED_STD = 1e2
"""Standard deviation of the first pose of an anchored graph [m, rad]; it keeps the problem solvable
if all anchors are refused."""
LEAST_AGREEING = 5
"""Number of loop closures at least that must agree with each other to doubt odometry's height."""
STEADY = 0.25
"""Odometry climbs steadily if half of the closures say so within this share of the climb."""
_Mark: TypeAlias = tuple[str, str, int, int]
GTSAM_ORDER = np.array([3, 4, 5, 0, 1, 2])
"""GTSAM orders a motion as turn, then offset."""


@dataclass(frozen=True)
class SolverParams:
    """When a closure counts as wrong."""

    max_chi_square: Annotated[
        float,
        Bounds(1.0, 1_000_000.0, 0.5, "", slider=(5.0, 100.0)),
        Doc(
            "A loop closure is refused if its chi-square in the corrected map is above this. 22.5 "
            "refuses one right loop closure in a thousand."
        ),
    ] = 22.5

    def __post_init__(self) -> None:
        check_bounds(self)


@dataclass(frozen=True, eq=False)
class EdgeFit:
    """How well one edge agrees with the corrected map.

    Attributes:
        edge: The edge as it was measured.
        chi_square: Squared error over its covariance, at the corrected poses.
        weight: 1 if the edge was used, 0 if it was refused as wrong.
    """

    edge: Edge
    chi_square: float
    weight: float


@dataclass(frozen=True, eq=False)
class AnchorFit:
    """How well one anchor agrees with the corrected map; as `EdgeFit`."""

    anchor: Anchor
    chi_square: float
    weight: float


@dataclass(frozen=True, eq=False)
class OptimisedGraph:
    """A solved pose graph.

    Attributes:
        poses: Corrected ``T_world_submap`` by id, in the graph's order.
        edges: How well each edge agrees with the corrected poses, in the graph's order.
        history: All poses before the first round, after each round and at the end. Each row is a
            submap's x, y, z [m], qx, qy, qz, qw.
        anchors: How well each anchor agrees with the corrected poses, in the graph's order.
        height_drift: What odometry's height must have drifted by, as a share of the distance, if
            most loop closures are right that contradict it; None if most do not.
        height_doubted: Whether they outweigh odometry, whose edges have this drift then.
        centres: `Submap.centre` by id, as the graph has them.
    """

    poses: dict[str, Pose]
    edges: tuple[EdgeFit, ...]
    history: Float[Array, "rounds n 7"]
    anchors: tuple[AnchorFit, ...] = ()
    height_drift: float | None = None
    height_doubted: bool = False
    centres: Centres = field(default_factory=dict)

    def __post_init__(self) -> None:
        read_only(self.history)

    @property
    def centred(self) -> "OptimisedGraph":
        """The same solution between the centres of its submaps, as `PoseGraph.centred` is."""
        history = shifted_rows(self.history, centres_of(self.centres, self.poses))
        poses = poses_of(self.poses, history[-1])
        return replace(self, poses=poses, history=history, centres={})

    @property
    def loops(self) -> tuple[EdgeFit, ...]:
        """The loop closures."""
        return tuple(fit for fit in self.edges if fit.edge.kind == "loop")

    @property
    def refused(self) -> tuple[EdgeFit, ...]:
        """The loop closures that were refused as wrong."""
        return tuple(fit for fit in self.loops if fit.weight < 0.5)

    @property
    def height_note(self) -> str:
        """A note on odometry's height; empty if most closures agree with it."""
        if self.height_drift is None:
            return ""
        taken = "this was taken" if self.height_doubted else "they would with this"
        return (
            f"most of {len(self.loops)} loop closures do not agree with odometry's height, but "
            f"with each other; {taken}: --graph.height-drift {self.height_drift:g}"
        )

    def at(self, share: float) -> dict[str, Pose]:
        """Interpolate the poses between before (0) and after (1), at a steady pace."""
        # A frame's origin may lie anywhere, and would swing the ground about.
        centres = centres_of(self.centres, self.poses)
        history = shifted_rows(self.history, centres)
        moved = np.diff(history[..., :3], axis=0)
        way = np.concatenate([[0.0], np.cumsum(np.sqrt((moved**2).sum(axis=2).mean(axis=1)))])
        place = float(np.clip(share, 0.0, 1.0)) * way[-1]
        k = int(np.clip(np.searchsorted(way, place, side="right") - 1, 0, max(len(way) - 2, 0)))
        if way[-1] == 0:
            return dict(self.poses)
        between = (place - way[k]) / max(way[k + 1] - way[k], 1e-12)
        rows = interpolated_rows(history[k], history[k + 1], between)
        return poses_of(self.poses, shifted_rows(rows, -centres))


@contextlib.contextmanager
def _determined() -> Generator[None]:
    """Raise an error of one line if GTSAM finds no solution."""
    try:
        yield
    except RuntimeError as error:
        if "Indeterminate" not in str(error):
            raise
        raise InputError(
            "odometry and loop closures differ by so much that the pose graph has no solution; are "
            "odometry's poses in metres?"
        ) from None


@_determined()
def optimise_pose_graph(
    graph: "PoseGraph | Problem",
    params: SolverParams | None = None,
    progress: Progress = silent,
    *,
    start: Mapping[str, Pose] | None = None,
) -> OptimisedGraph:
    """Find the poses that odometry and closures agree on, and the closures that are wrong.

    This is graduated non-convexity with truncated least squares (Yang, Antonante, Tzoumas and
    Carlone 2020, Sec. IV): at first all closures pull weakly, and from round to round the limit on
    their error becomes sharper. Unlike in GTSAM's own implementation, each round starts from the
    poses of the last one and takes only two steps, and the first weights come from the odometry's
    poses. At the end, refused closures are used again if that lowers the truncated loss: where
    odometry is far less certain than a closure, the weak pull of the first rounds moves nothing,
    and a right closure is refused for an error that it would have removed. With one closure in
    five wrong, 1,000 submaps take 5 s instead of 47 s.

    Where most closures are refused, but would agree with each other and with all of odometry except
    its height, that one is doubted: it drifts by as much as explains the median closure, if this
    makes the whole more likely. There is no such doubt in a graph with anchors.

    Args:
        graph: The pose graph; its first pose does not move unless it has anchors. A `Problem` of
            it spares some work.
        params: When a closure counts as wrong. Anchors are doubted like closures.
        progress: Called once per round; may raise Cancelled.
        start: Poses that are nearer to the solution than the graph's own; None takes these.

    Raises:
        InputError: If GTSAM is not installed, or finds no solution.
    """
    params = params or SolverParams()
    problem, graph = (graph, graph.graph) if isinstance(graph, Problem) else (None, graph)
    if not graph.loops and not graph.anchors:
        progress(1.0)
        fits = tuple(EdgeFit(edge, 0.0, 1.0) for edge in graph.edges)
        before = pose_rows(graph.poses)[None]
        return OptimisedGraph(dict(graph.poses), fits, before, centres=graph.centres)
    problem = problem or Problem(graph, start)
    result = _solve(problem, params, progress)
    if 2 * len(result.refused) > len(result.loops) and not graph.anchors:
        drift, steady = _height_drift(graph.centred)
        loosened = Problem(loosen_height(graph, drift), start)
        doubting = _solve(loosened, params, lambda _: progress(0.95))
        agreeing = len(doubting.loops) - len(doubting.refused)
        if 2 * agreeing > len(doubting.loops):
            doubted = steady and agreeing >= LEAST_AGREEING
            result = doubting if doubted else result
            result = replace(result, height_drift=drift, height_doubted=doubted)
    progress(1.0)
    return result


def _solve(problem: "Problem", params: SolverParams, progress: Progress) -> OptimisedGraph:
    """Solve a graph as `optimise_pose_graph` does, without a doubt of odometry."""
    values, rounds = _sharpen(problem, params.max_chi_square, progress)
    values, weight = _converge(problem, values, params.max_chi_square)
    values, weight = _take_back(problem, values, weight, params.max_chi_square, progress)
    history = [pose_rows(problem.graph.poses), *rounds, problem.rows(values)]
    edges, anchors = problem.fits(values, weight)
    poses = poses_of(problem.graph.poses, history[-1])
    centres = problem.graph.centres
    return OptimisedGraph(poses, edges, np.array(history), anchors, centres=centres)


def _height_drift(graph: PoseGraph) -> tuple[float, bool]:
    """Find the drift that explains the median closure's height, and if it is a steady climb."""
    way = {name: np.array([k, 0.0, 0.0]) for k, name in enumerate(graph.poses)}
    for edge in graph.edges:
        if edge.kind == "odometry":  # where the traverse starts, distances since and their squares
            distance = float(np.linalg.norm(edge.T_start_end.translation))
            way[edge.end] = way[edge.start] + [0.0, distance, distance**2]
    rows: list[Array] = []
    for edge in graph.loops:
        row = way[edge.end] - way[edge.start]
        if row[0] == 0 and row[1] != 0:
            predicted = graph.poses[edge.start].inverse() @ graph.poses[edge.end]
            row[0] = edge.T_start_end.translation[2] - predicted.translation[2]
            rows.append(row)
    if not rows:
        return 0.0, False
    off, length, squares = np.array(rows).T
    climbs = off / length
    climb = np.median(climbs)
    steady = np.median(np.abs(climbs - climb)) < STEADY * abs(climb)
    return min(float(f"{np.median(np.abs(off / np.sqrt(abs(squares)))):.2g}"), 1.0), bool(steady)


def loosen_height(graph: PoseGraph, drift: float) -> PoseGraph:
    """Let odometry's height drift by a further share of the distance."""
    further = np.diag([0.0, 0.0, drift**2, 0.0, 0.0, 0.0])

    def loosened(edge: Edge) -> Edge:
        squares = np.sum(graph.between_centres(edge).translation ** 2)
        return replace(edge, covariance=edge.covariance + squares * further)

    return replace(graph, edges=tuple(e if e.kind == "loop" else loosened(e) for e in graph.edges))


@_determined()
def optimise_onward(
    problem: "Problem",
    last: OptimisedGraph,
    params: SolverParams | None = None,
) -> OptimisedGraph | None:
    """Solve a graph that has grown since its last solution; None if all must be weighed anew.

    That is so if a new closure contradicts the solution, or if that one doubts odometry.
    """
    params, graph = params or SolverParams(), problem.graph
    entered = {edge.end for edge in graph.edges if edge.kind == "odometry"}
    start, before = dict[str, Pose](), ""
    for name, pose in graph.poses.items():
        if name in last.poses:
            start[name] = last.poses[name]
        elif name in entered:
            start[name] = start[before] @ (graph.poses[before].inverse() @ pose)
        else:
            start[name] = pose
        before = name
    if last.height_doubted:
        return None
    values = problem.values(start)
    earlier = {(fit.edge.start, fit.edge.end) for fit in last.loops}
    is_new = np.array(
        [(edge.start, edge.end) not in earlier for edge in graph.edges if not edge.trusted], bool
    )
    # With all new ones: odometry alone may not place a submap as exactly as they do.
    used = is_new | (problem.chi_squares(values) <= params.max_chi_square)
    refusing = problem.truncated_loss(values, params.max_chi_square)
    values = problem.improve(values, used.astype(np.float64), STEPS_A_ROUND)
    if np.any(is_new & (problem.chi_squares(values) > params.max_chi_square)):
        return None
    values, weight = _converge(problem, values, params.max_chi_square)
    if problem.truncated_loss(values, params.max_chi_square) > refusing:
        return None  # odometry contradicts them
    rows = problem.rows(values)
    edges, _ = problem.fits(values, weight)
    history = np.array([pose_rows(start), rows])
    return OptimisedGraph(poses_of(graph.poses, rows), edges, history, centres=graph.centres)


def _sharpen(
    problem: "Problem", limit: float, progress: Progress
) -> tuple["gtsam.Values", list[Float[Array, "n 7"]]]:
    """Run rounds of growing sharpness until each closure is clearly right or wrong."""
    values = problem.start
    chi_square = problem.chi_squares(values)
    # The sharpness at which every closure lies on the slope of the truncated loss, Remark 5.
    sharpness = limit / max(2 * float(chi_square.max(initial=0.0)) - limit, 1e-9)
    rounds: list[Float[Array, "n 7"]] = []
    for count in range(MOST_ROUNDS):
        low, high = sharpness / (sharpness + 1) * limit, (sharpness + 1) / sharpness * limit
        weight = np.clip(
            np.sqrt(limit * sharpness * (sharpness + 1) / np.maximum(chi_square, 1e-12))
            - sharpness,
            0.0,
            1.0,
        )  # Eq. (14)
        values = problem.improve(values, weight, STEPS_A_ROUND)
        chi_square = problem.chi_squares(values)
        rounds.append(problem.rows(values))
        if not np.any((chi_square > low) & (chi_square < high)):
            break
        sharpness *= GROWTH
        progress(0.9 * (count + 1) / MOST_ROUNDS)
    return values, rounds


def _converge(
    problem: "Problem", values: "gtsam.Values", limit: float
) -> tuple["gtsam.Values", Float[Array, "loops"]]:
    """Solve with the right closures alone until their choice no longer changes."""
    last = consistent = problem.chi_squares(values) <= limit
    for _ in range(MOST_ROUNDS):
        values = problem.improve(values, consistent.astype(np.float64))
        last, consistent = consistent, problem.chi_squares(values) <= limit
        if np.array_equal(last, consistent):
            break
    return values, last.astype(np.float64)


def _take_back(
    problem: "Problem",
    values: "gtsam.Values",
    weight: Float[Array, "loops"],
    limit: float,
    progress: Progress,
) -> tuple["gtsam.Values", Float[Array, "loops"]]:
    """Use refused closures again, the best first, as long as that lowers the truncated loss."""
    loss = problem.truncated_loss(values, limit)
    for _ in range(MOST_ROUNDS):
        progress(0.95)
        best = problem.best_refused(values, weight, limit)
        if best is None:
            break
        more = weight.copy()
        more[best] = 1.0
        then, used = _converge(problem, problem.improve(values, more), limit)
        lower = problem.truncated_loss(then, limit)
        if lower >= loss:
            break
        values, weight, loss = then, used, lower
    return values, weight


def measure_covariances(
    graph: "PoseGraph | Problem", result: OptimisedGraph, names: Sequence[str] | None = None
) -> Float[Array, "n 3 3"]:
    """Measure the covariances of the centres' x [m], y [m] and yaw [rad] in the names' order."""
    plane = np.array([0, 1, 5])
    return measure_pose_covariances(graph, result, names)[:, plane[:, None], plane]


def measure_pose_covariances(
    graph: "PoseGraph | Problem", result: OptimisedGraph, names: Sequence[str] | None = None
) -> Float[Array, "n 6 6"]:
    """Measure how certain the poses of a solved graph are, by what was used.

    The covariance is that of the x, y, z [m] of each submap's centre and its small rotation about
    x, y, z [rad] in the world, relative to the first submap's pose, or to the world if the graph
    has anchors. Names of None measure all; some take a third of the time of GTSAM's marginals.
    """
    problem = graph if isinstance(graph, Problem) else Problem(graph)
    if result.height_doubted and result.height_drift is not None:
        problem = Problem(loosen_height(problem.graph, result.height_drift))
    selected = tuple(result.poses) if names is None else names
    to_world = np.zeros((len(selected), 6, 6))
    for k, name in enumerate(selected):
        # GTSAM's is that of a turn and an offset in the submap's frame.
        to_world[k, :3, 3:] = to_world[k, 3:, :3] = result.poses[name].rotation
    return to_world @ problem.covariances(result, names) @ np.swapaxes(to_world, 1, 2)


def check_solver() -> ModuleType:
    """Load GTSAM, before long work that ends in a pose graph; InputError if it is missing."""
    try:
        return load_library("gtsam", "gtsam>=4.3")
    except InputError as error:
        raise InputError(f"pose graphs need GTSAM: {error}") from None


@dataclass(frozen=True, eq=False)
class _Term:
    """A measurement of one pose, or between two, as GTSAM has it."""

    keys: tuple[int, ...]
    measured: "gtsam.Pose3"
    information: Float[Array, "6 6"]

    @cached_property
    def factor(self) -> "_Factor":
        return self.weighted(1.0)

    def weighted(self, importance: float) -> "_Factor":
        gtsam = check_solver()
        noise = gtsam.noiseModel.Gaussian.Information(importance * self.information)
        if len(self.keys) == 1:
            return gtsam.PriorFactorPose3(*self.keys, self.measured, noise)
        return gtsam.BetweenFactorPose3(*self.keys, self.measured, noise)


class Problem:
    """A pose graph as GTSAM's factors, edges before anchors; some of these may be wrong."""

    _chi_squares: "tuple[gtsam.Values, Float[Array, 'loops']] | None" = None  # and where

    def __init__(
        self,
        graph: PoseGraph,
        start: Mapping[str, Pose] | None = None,
        *,
        last: "Problem | None" = None,
    ) -> None:
        """Make the factors; what a graph has in common with the last one is not made again."""
        self._gtsam = gtsam = check_solver()
        # Variables are the poses of the centres: a frame whose origin lies far from its ground
        # would turn each error of a yaw into one of its position.
        self.graph, self.start = graph, gtsam.Values()
        self.keys = {name: key for key, name in enumerate(graph.poses)}
        terms = dict[_Mark, _Term]()
        level, felt = gtsam.noiseModel.Isotropic.Sigma(2, graph.tilt_std), {}
        if last is not None and [*graph.poses][: len(last.keys)] == [*last.keys]:
            terms = dict(last._terms_by_mark)
            felt = last._felt if graph.tilt_std == last.graph.tilt_std else felt
        reordered = np.ix_(GTSAM_ORDER, GTSAM_ORDER)
        marks = [_mark(edge) for edge in graph.edges]
        new = [edge for edge, mark in zip(graph.edges, marks, strict=True) if mark not in terms]
        covariances = np.array([edge.covariance[reordered] for edge in new]).reshape(-1, 6, 6)
        for edge, information in zip(new, np.linalg.inv(covariances), strict=True):
            motion = self._gtsam_pose(graph.between_centres(edge))
            keys = self.keys[edge.start], self.keys[edge.end]
            terms[_mark(edge)] = _Term(keys, motion, information)
        self._terms = [terms[mark] for mark in marks]
        self._terms_by_mark = dict(zip(marks, self._terms, strict=True))
        for anchor in graph.anchors:
            information = anchor.information[reordered] + LOOSE_STD**-2 * np.eye(6)
            measured = self._pose(anchor.submap, anchor.T_world_submap)
            self._terms.append(_Term((self.keys[anchor.submap],), measured, information))
        self._doubted: list[int] = []
        self._certain = gtsam.NonlinearFactorGraph()
        for k, one in enumerate((*graph.edges, *graph.anchors)):
            if one.trusted:
                self._certain.add(self._terms[k].factor)
            else:
                self._doubted.append(k)
        self._felt: dict[str, _Felt] = {}  # by each submap's pose
        entered = {edge.end for edge in graph.edges if edge.kind == "odometry"}
        up = np.array([0.0, 0.0, 1.0])
        for name, pose in graph.poses.items():
            key, earlier = self.keys[name], felt.get(name)
            if earlier is None or earlier[0] is not pose:
                # Gravity. Without it, many small tilts would bend a traverse to fit a wrong height.
                down = gtsam.Unit3(pose.rotation.T @ up)
                upright = gtsam.AttitudeFactorPose3(key, gtsam.Unit3(up), level, down)
                earlier = pose, self._pose(name, pose), upright
            self._felt[name] = earlier
            _, T_world_submap, upright = earlier
            begin = T_world_submap if start is None else self._pose(name, start[name])
            self.start.insert(key, begin)
            if name not in entered:  # the start of a traverse
                first = ANCHORED_STD if graph.anchors else FIRST_STD
                std = first if key == 0 else LOOSE_STD
                held = gtsam.noiseModel.Isotropic.Sigma(6, std)
                self._certain.add(gtsam.PriorFactorPose3(key, T_world_submap, held))
            self._certain.add(upright)

    def improve(
        self, values: "gtsam.Values", weight: Float[Array, "loops"], steps: int | None = None
    ) -> "gtsam.Values":
        """Move the values closer to the solution by so many steps; None takes as many as needed."""
        graph = self._gtsam.NonlinearFactorGraph(self._certain)
        for k, importance in zip(self._doubted, weight.tolist(), strict=True):
            if importance > 0:
                term = self._terms[k]
                graph.add(term.factor if importance == 1 else term.weighted(importance))
        params = self._gtsam.LevenbergMarquardtParams()
        if steps is not None:
            params.setMaxIterations(steps)
        return self._gtsam.LevenbergMarquardtOptimizer(graph, values, params).optimize()

    @_determined()
    def covariances(
        self, result: OptimisedGraph, names: Sequence[str] | None
    ) -> Float[Array, "n 6 6"]:
        """Compute the covariances of poses, in GTSAM's order, by the edges that a solution used.

        With H = RᵀR eliminated, the covariance H⁻¹ of a pose is YᵀY, and RᵀY = E has only six
        columns for it. R is solved submap by submap, so it stays sparse.
        """
        fits, values = (*result.edges, *result.anchors), self.values(result.poses)
        used = self._used(np.array([fits[k].weight for k in self._doubted]))
        if names is None:
            marginals = self._gtsam.Marginals(used, values)
            return np.array([marginals.marginalCovariance(key) for key in self.keys.values()])
        keys = [self.keys[name] for name in names]
        net = used.linearize(values).eliminateSequential()
        columns = np.zeros((len(self.keys), 6, 6 * len(keys)))
        for place, key in enumerate(keys):
            columns[key, :, 6 * place : 6 * place + 6] = np.eye(6)
        with single_threaded_libraries():  # sums must not depend on the number of threads
            for k in range(net.size()):
                conditional = net.at(k)
                key, *parents = conditional.keys()
                columns[key] = np.linalg.solve(conditional.R().T, columns[key])
                if parents:
                    onward = conditional.S().T @ columns[key]
                    columns[parents] -= onward.reshape(len(parents), 6, -1)
        solved = columns.reshape(-1, len(keys), 6)
        return np.einsum("rka,rkb->kab", solved, solved)

    def _used(self, weight: Float[Array, "loops"]) -> "gtsam.NonlinearFactorGraph":
        graph = self._gtsam.NonlinearFactorGraph(self._certain)
        for k, used in zip(self._doubted, weight.tolist(), strict=True):
            if used >= 0.5:
                graph.add(self._terms[k].factor)
        return graph

    def truncated_loss(self, values: "gtsam.Values", limit: float) -> float:
        """Add up the squared errors over their covariances; a doubted one counts up to a limit."""
        doubted = np.minimum(self.chi_squares(values), limit)
        return 2 * float(self._certain.error(values)) + float(doubted.sum())

    def best_refused(
        self, values: "gtsam.Values", weight: Float[Array, "loops"], limit: float
    ) -> int | None:
        """Find the refused one that would add least to the squared errors; None above the limit.

        It adds its innovation: its squared error over its own covariance and that of the poses
        together. A bound on that, from each pose's covariance alone, spares most of the work.
        """
        refused = np.flatnonzero(weight < 0.5)
        if not len(refused):
            return None
        marginals = self._gtsam.Marginals(self._used(weight), values)
        alone = cache(marginals.marginalCovariance)
        lines = dict[int, tuple[list[int], Float[Array, "6 c"], Float[Array, "6"]]]()
        bounds = dict[int, float]()
        for number in map(int, refused):
            factor = self._terms[self._doubted[number]].factor
            jacobian, error = factor.linearize(values).jacobian()
            keys = list(factor.keys())
            lines[number] = keys, jacobian, error
            spread = np.eye(6)
            for block, key in zip(np.hsplit(jacobian, len(keys)), keys, strict=True):
                spread += len(keys) * block @ alone(key) @ block.T
            bounds[number] = float(error @ np.linalg.solve(spread, error))
        best, least = None, limit
        for number in sorted(bounds, key=bounds.__getitem__):
            if bounds[number] >= least:
                break
            keys, jacobian, error = lines[number]
            joint = marginals.jointMarginalCovariance(keys)
            covariance = np.block([[joint.at(a, b) for b in keys] for a in keys])
            spread = np.eye(6) + jacobian @ covariance @ jacobian.T
            innovation = float(error @ np.linalg.solve(spread, error))
            if innovation < least:
                best, least = number, innovation
        return best

    def values(self, poses: Mapping[str, Pose]) -> "gtsam.Values":
        values = self._gtsam.Values()
        for name, pose in poses.items():
            values.insert(self.keys[name], self._pose(name, pose))
        return values

    def chi_squares(self, values: "gtsam.Values") -> Float[Array, "loops"]:
        """Squared errors of the doubted closures over their covariances."""
        cached = self._chi_squares
        if cached is None or cached[0] is not values:
            errors = [2 * self._terms[k].factor.error(values) for k in self._doubted]
            cached = self._chi_squares = values, np.array(errors)
        return cached[1]

    def fits(
        self, values: "gtsam.Values", weight: Float[Array, "loops"]
    ) -> tuple[tuple[EdgeFit, ...], tuple[AnchorFit, ...]]:
        """Measure how well each edge and each anchor agrees with the values."""
        doubted = zip(self.chi_squares(values).tolist(), weight.tolist(), strict=True)
        of_doubted = dict(zip(self._doubted, doubted, strict=True))
        fits = [
            of_doubted.get(k) or (2 * term.factor.error(values), 1.0)
            for k, term in enumerate(self._terms)
        ]
        edges, anchors = self.graph.edges, self.graph.anchors
        first = len(edges)
        return (
            tuple(EdgeFit(edge, *fit) for edge, fit in zip(edges, fits[:first], strict=True)),
            tuple(AnchorFit(one, *fit) for one, fit in zip(anchors, fits[first:], strict=True)),
        )

    def rows(self, values: "gtsam.Values") -> Float[Array, "n 7"]:
        """Convert the poses to rows of offset and quaternion, of the frames' origins again."""
        matrices = np.asarray(self._gtsam.utilities.extractPose3(values), dtype=np.float64)
        rotations = Rotation.from_matrix(matrices[:, :9].reshape(-1, 3, 3))
        rows = np.column_stack([matrices[:, 9:], rotations.as_quat(canonical=True)])
        return shifted_rows(rows, -centres_of(self.graph.centres, self.keys))

    def _pose(self, name: str, pose: Pose) -> "gtsam.Pose3":
        return self._gtsam_pose(self.graph.at_centre(name, pose))

    def _gtsam_pose(self, pose: Pose) -> "gtsam.Pose3":
        x, y, z, w = pose.quaternion
        turn = self._gtsam.Rot3.Quaternion(w, x, y, z)
        return self._gtsam.Pose3(turn, pose.translation)


def _mark(edge: Edge) -> _Mark:
    """A key of an edge, as long as it exists; the score is no part of it."""
    return edge.start, edge.end, id(edge.T_start_end), id(edge.covariance)


def pose_rows(poses: Mapping[str, Pose]) -> Float[Array, "n 7"]:
    """List poses as rows of x, y, z [m], qx, qy, qz, qw (n, 7)."""
    return np.array([pose.row for pose in poses.values()])


def interpolated_rows(
    start: Float[Array, "n 7"], stop: Float[Array, "n 7"], share: float
) -> Float[Array, "n 7"]:
    """Interpolate between poses in the rows of `pose_rows`; they turn the short way round."""
    offsets = (1 - share) * start[:, :3] + share * stop[:, :3]
    first, last = Rotation.from_quat(start[:, 3:]), Rotation.from_quat(stop[:, 3:])
    turns = first * Rotation.from_rotvec(share * (first.inv() * last).as_rotvec())
    return np.column_stack([offsets, turns.as_quat()])


def centres_of(centres: Centres, names: Iterable[str]) -> Float[Array, "n 3"]:
    """List the centres of named submaps [m]; the origin for those that are missing."""
    return np.array([centres.get(name, np.zeros(3)) for name in names]).reshape(-1, 3)


def shifted_rows(
    rows: Float[Array, "*rounds n 7"], offsets: Float[Array, "n 3"]
) -> Float[Array, "*rounds n 7"]:
    """Move poses in the rows of `pose_rows` by offsets [m] along the axes of their own frames."""
    places, quaternions = rows[..., :3], rows[..., 3:]
    along = (np.zeros_like(places) + offsets).reshape(-1, 3)
    turned = Rotation.from_quat(quaternions.reshape(-1, 4)).apply(along)
    return np.concatenate([places + turned.reshape(places.shape), quaternions], axis=-1)


def poses_of(names: Iterable[str], rows: Float[Array, "n 7"]) -> dict[str, Pose]:
    """Make poses of the rows of `pose_rows`, by the names in their order."""
    return {name: Pose.of_row(row) for name, row in zip(names, rows, strict=True)}
