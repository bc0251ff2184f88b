"""What the other pairs of a dataset say about one: whether the ground repeats, and what agrees.

A pair alone tells one terrain from unrelated terrain. Where the ground repeats there is a third
hypothesis, similar terrain, and one pair can hardly exclude it. A dataset can, in two ways. Its
neighbours show how much the heights of one terrain differ; similar terrain differs by more. And its
closures form cycles: motions of one terrain lead back to where they began, and similar places,
which lie one or two spacings beside the true one, do not.
"""

from collections import deque
from collections.abc import Mapping, Sequence
from collections.abc import Set as AbstractSet
from dataclasses import dataclass, replace
from itertools import pairwise
from math import exp, gamma, hypot, inf, log, log10, pi

import numpy as np
from jaxtyping import Bool, Float, Int

from gpgrad_core.arrays import Array, NDArray
from gpgrad_core.se2 import SE2
from gpgrad_core.types import Context, LoopClosure, Registration

Pair = tuple[int, int]

USUAL_MISFIT, USUAL_WEIGHT = 0.85, 3.0
"""How many times the heights of one terrain differ more than the uncertainty of the maps explains,
before a dataset has shown it, and how many neighbours that counts as. The medians of 15 datasets
(five real ones; whole, thinned and noisy) lie between 0.5 and 1.4, because noise is never known
exactly."""
MISFIT_SPREAD = 0.22
"""Spread of the logarithm of that within a dataset: 0.14 to 0.29 in the same datasets."""
MOST_KEPT = 2.0
"""Unusual heights leave half of a score, up to this: enough to rank what is not accepted."""
NEIGHBOUR_SCORE = 3.0
"""Neighbours with at least this score show what is usual."""
TRIED_BESIDE = 1.0
"""Logarithm of the number of pairs apart for each true one: a score of s is the chance of one pair
apart, so a closure of that score is wrong with a chance of 10^(this - s)."""
LEAST_LINK = 1.0
"""Lowest score of a pair that other pairs are compared with; below, it says nothing."""
NEXT = 0.5
"""What that is less for a submap and the next one: they mostly share ground."""
MOST_WRONG = 0.9
"""No link is more likely wrong than this: not even the worst says the opposite."""
MOST_SUPPORT = 1.5
"""Other closures raise a score by no more than this, less what unusual heights take off it: wrong
closures lead to the same place too if the ground repeats. So a pair needs evidence of its own."""
WINDOW = 2.0
"""Where a slightly wrong motion of the right place may lie: 1.2 scales to either side along x and
y, and 10 degrees to either side [scales² rad]."""
LEAST_STD, LEAST_YAW_STD = 0.1, 0.003
"""Standard deviations of a motion beyond what its registration says [scales], [rad]: submaps are
warped."""
FREEDOM = 3.0
"""Degrees of freedom of the distribution of what is left when a cycle is closed (Student's t)."""
ODOMETRY_DRIFT, ODOMETRY_TURN, ODOMETRY_SCORE = 0.05, 0.02, 4.0
"""Standard deviations of odometry from one submap to the next, per distance driven [m/m] and in
heading [rad]; and the score that it counts as."""
APART, PLACE_SCORE = 3.0, 2.5
"""Places of a submap count as two if they are further apart than this [scales]; and motions count
as places from this score on."""
CONTRADICTED = -0.3
"""A motion with less support than this, and that far off, leads to another place."""
LEAD, REPEATED, USUAL = 2.0, (0.2, 0.35), 1.3
"""A closure may have this score where another place of a submap fits as well as its own, as long as
that is rare: of the closures whose heights differ by no more than so many times what is usual, at
most the first share leads elsewhere. From the second share on the ground cannot be told apart, and
a closure needs all of its score as a lead. Chosen so that nothing is accepted on simulated dunes
and spurs whose rows are all alike, and little is lost on real ground."""

MOST_AT_ONCE = 100_000
"""Links of cycles that are computed at once, in some 50 MB."""


def weigh_others(
    registrations: Mapping[Pair, Registration], odometry: Sequence[SE2 | None] = ()
) -> dict[Pair, Context]:
    """Weigh each pair of a dataset by all the others.

    A score is the logarithm of a chance, so what is added to it are logarithms too:

    - Of a pair whose heights differ by z usual spreads more than is usual, -z² / 2, as a natural
      logarithm: so much less likely is that difference on one terrain.
    - The pairs are joined to a forest, those of the highest scores first. Every other pair closes a
      cycle. With d what is left when the cycle is closed, C its covariance and ε the chance that
      another motion of the cycle is wrong, the motion is more likely than a slightly wrong one of
      the same place by

          log10((1 - ε) t(d; C) WINDOW + ε)

      A pair of the forest is weighed by the cycle of the best pair that could replace it.
    - A score is worth no more than how rare it is among pairs that lead elsewhere.

    Args:
        registrations: The registration of each pair (query, database); the indices are in the order
            in which the submaps were made. Their scores are those of the pair alone.
        odometry: ``T_odometry_submap`` of each submap, if odometry may speak; None where there is
            none.

    Returns:
        What is said of each pair whose terrain was compared.
    """
    compared = {
        pair: registration
        for pair, registration in registrations.items()
        if registration.agreement is not None
    }
    misfits, against = _unusual(compared)
    scores = {
        pair: max(registration.score - against[pair], 0.0)
        for pair, registration in compared.items()
    }
    links = _Links.of(compared, scores, odometry)
    forest = _Forest.of(links)
    support, leads_elsewhere = links.weigh(forest)
    # What the cycles say of odometry is not said of the pair that it leads through.
    linked = [(query, database) for query, database in links.pairs[links.is_pair].tolist()]
    said = dict(zip(linked, support[links.is_pair].tolist(), strict=True))
    far = leads_elsewhere[links.is_pair]
    elsewhere = {pair for pair, leads in zip(linked, far, strict=True) if leads}
    rivals = _Rivals.of({pair: scores[pair] for pair in linked}, elsewhere, misfits)
    shown = _Shown.by([scores[pair] for pair in elsewhere], len(registrations))
    places = links.count_places(forest)
    contexts: dict[Pair, Context] = {}
    for pair, registration in compared.items():
        kept = max(shown.most(scores[pair]), min(registration.score / 2, MOST_KEPT))
        raised = min(said.get(pair, 0.0), max(MOST_SUPPORT - against[pair], 0.0))
        score = min(kept + raised, rivals.most(pair))
        several = max(places.get(submap, 1) for submap in pair)
        contexts[pair] = Context(
            registration.score, max(score, 0.0), misfits[pair], said.get(pair, 0.0), several
        )
    return contexts


@dataclass(frozen=True, eq=False)
class _Shown:
    """How rare scores are among pairs that lead elsewhere, which are wrong.

    A score s promises that of pairs apart one in 10^s reaches it. On ground that repeats more do.
    So where n pairs were compared and N that lead elsewhere reach a score, it is worth no more than
    log10(n / (N - 1)); one of them may be a mistake.

    Attributes:
        wrong: Scores of the pairs that lead elsewhere (k,), ascending.
        num_pairs: Number of pairs that were compared.
    """

    wrong: Float[Array, "k"]
    num_pairs: int

    @classmethod
    def by(cls, wrong: Sequence[float], num_pairs: int) -> "_Shown":
        """Sort the scores."""
        return cls(np.sort(np.array(wrong, np.float64)), num_pairs)

    def most(self, score: float) -> float:
        """Give what is left of a score."""
        reached = len(self.wrong) - int(np.searchsorted(self.wrong, score))
        return score if reached < 2 else min(score, log10(self.num_pairs / (reached - 1)))


@dataclass(frozen=True)
class _Rivals:
    """The best scores with which submaps are placed where most closures put them, and elsewhere.

    Attributes:
        here: Of each submap.
        elsewhere: Of each that is put elsewhere too.
        lead: A closure may have this score without any lead over those that put its submaps
            elsewhere.
    """

    here: Mapping[int, float]
    elsewhere: Mapping[int, float]
    lead: float

    @classmethod
    def of(
        cls,
        scores: Mapping[Pair, float],
        elsewhere: AbstractSet[Pair],
        misfits: Mapping[Pair, float],
    ) -> "_Rivals":
        """Find them, and how much the ground of the dataset repeats."""
        best: tuple[dict[int, float], dict[int, float]] = {}, {}
        for pair, score in scores.items():
            if pair in elsewhere and score < PLACE_SCORE:
                continue
            for submap in pair:
                places = best[pair in elsewhere]
                places[submap] = max(score, places.get(submap, 0.0))
        usual = [
            pair in elsewhere
            for pair, score in scores.items()
            if score >= PLACE_SCORE and misfits[pair] <= USUAL
        ]
        repeated = sum(usual) / max(len(usual), 1)
        low, high = REPEATED
        return cls(*best, LEAD * min(max((high - repeated) / (high - low), 0.0), 1.0))

    def most(self, pair: Pair) -> float:
        """The highest score that rival places of its submaps leave to a pair."""
        leads = [
            self.here.get(submap, 0.0) - self.elsewhere[submap]
            for submap in pair
            if submap in self.elsewhere
        ]
        return min(leads) + self.lead if leads else inf


def own_registration(closure: LoopClosure) -> Registration:
    """Give the registration of a closure with the score of the pair alone."""
    registration, context = closure.registration, closure.context
    return registration if context is None else replace(registration, score=context.own_score)


def _unusual(compared: Mapping[Pair, Registration]) -> tuple[dict[Pair, float], dict[Pair, float]]:
    """Compare how much heights differ with what is usual; also gives what that takes off scores."""
    ratios = {pair: log(_misfit(registration)) for pair, registration in compared.items()}
    shown = [
        ratios[query, database]
        for (query, database), registration in compared.items()
        if query - database == 1 and registration.score >= NEIGHBOUR_SCORE
    ]
    usual = log(USUAL_MISFIT)
    if shown:
        # Where the ground repeats, neighbours may have wrong motions, which differ more. So the
        # middle is told from the fifth that differs least.
        middle = float(np.quantile(shown, 0.2)) + 0.84 * MISFIT_SPREAD
        usual += (middle - usual) * len(shown) / (len(shown) + USUAL_WEIGHT)
    misfits = {pair: exp(ratio - usual) for pair, ratio in ratios.items()}
    return misfits, {pair: score_against(misfit) for pair, misfit in misfits.items()}


def score_against(misfit: float) -> float:
    """Compute what heights that differ so many times more than is usual take off a score."""
    return max(log(misfit) / MISFIT_SPREAD, 0.0) ** 2 / 2 / log(10)


def _misfit(registration: Registration) -> float:
    """How many times more the heights differ than the uncertainty of both maps explains."""
    agreement = registration.agreement
    assert agreement is not None
    return max(agreement.difference, 1e-9) / max(agreement.possible, 1e-9)


def _turned(vectors: Float[Array, "n 2"], yaw: Float[Array, "n"]) -> Float[Array, "n 2"]:
    """Turn each vector by its own angle [rad]."""
    (x, y), c, s = vectors.T, np.cos(yaw), np.sin(yaw)
    return np.column_stack([c * x - s * y, s * x + c * y])


@dataclass(frozen=True, eq=False)
class _Links:
    """The motions that can be part of a cycle, the one with the highest score first.

    Attributes:
        pairs: The submaps of each (m, 2): query and database.
        motions: x [m], y [m] and yaw [rad] of ``T_database_query`` (m, 3).
        covariances: Of the motions (m, 3, 3).
        chances: That a motion is wrong (m,).
        is_pair: Whether it is a pair's motion (m,), and not odometry's.
        scale: Scale of comparison [m].
    """

    pairs: Int[NDArray[np.intp], "m 2"]
    motions: Float[Array, "m 3"]
    covariances: Float[Array, "m 3 3"]
    chances: Float[Array, "m"]
    is_pair: Bool[NDArray[np.bool_], "m"]
    scale: float

    @classmethod
    def of(
        cls,
        compared: Mapping[Pair, Registration],
        scores: Mapping[Pair, float],
        odometry: Sequence[SE2 | None],
    ) -> "_Links":
        """List the motions that say enough, and odometry if it may speak."""
        listed: list[tuple[float, Pair, bool, SE2, Float[Array, "3 3"]]] = []
        for pair, registration in compared.items():
            motion, covariance = registration.T_database_query, registration.covariance
            if scores[pair] >= LEAST_LINK and motion is not None and covariance is not None:
                following = NEXT if pair[0] - pair[1] == 1 else 0.0
                listed.append((scores[pair] + following, pair, True, motion, covariance))
        for k, (before, after) in enumerate(pairwise(odometry)):
            if before is not None and after is not None:
                step = before.inverse() @ after
                off = ODOMETRY_DRIFT * float(np.hypot(step.x, step.y))
                covariance = np.diag([off**2, off**2, ODOMETRY_TURN**2])
                listed.append((ODOMETRY_SCORE, (k + 1, k), False, step, covariance))
        listed.sort(key=lambda link: (-link[0], link[1], link[2]))
        scales = [registration.scale for registration in compared.values() if registration.scale]
        scale = float(np.median(scales)) if scales else 1.0
        beyond = np.diag([(LEAST_STD * scale) ** 2, (LEAST_STD * scale) ** 2, LEAST_YAW_STD**2])
        return cls(
            np.array([pair for _, pair, *_ in listed], np.intp).reshape(-1, 2),
            np.array([(motion.x, motion.y, motion.yaw) for *_, motion, _ in listed]).reshape(-1, 3),
            np.array([covariance for *_, covariance in listed]).reshape(-1, 3, 3) + beyond,
            np.minimum(
                10.0 ** np.array([TRIED_BESIDE - score for score, *_ in listed]), MOST_WRONG
            ),
            np.array([is_pair for _, _, is_pair, *_ in listed], bool),
            scale,
        )

    def close(
        self, closings: Int[NDArray[np.intp], "c"], paths: "_Paths", forest: "_Forest"
    ) -> tuple[Float[Array, "c"], Float[Array, "c"]]:
        """Compute the likelihoods of cycles, relative to slightly wrong motions of the same places.

        Args:
            closings: The links that close the cycles.
            paths: The links of the forest between the submaps of each.
            forest: Gives their places.

        Returns:
            The likelihoods, and by how much each cycle does not close [m].
        """
        query, database = self.pairs[closings].T
        # An error of a link's yaw moves the end of the cycle about the link's query.
        turned = forest.covariances[paths.links]
        arm = forest.poses[query[paths.cycles], :2] - forest.poses[self.pairs[paths.links, 0], :2]
        (x, y), yaw = arm.T, turned[:, 2, 2]
        along, across = turned[:, 0, 2] - y * yaw, turned[:, 1, 2] + x * yaw
        spread = (
            turned[:, 0, 0] - y * (turned[:, 0, 2] + along),
            turned[:, 0, 1] - y * turned[:, 1, 2] + x * along,
            turned[:, 1, 1] + x * (turned[:, 1, 2] + across),
            along,
            across,
            yaw,
        )
        covariance = np.array(
            [np.bincount(paths.cycles, each, minlength=len(closings)) for each in spread]
        )[[0, 1, 3, 1, 2, 4, 3, 4, 5]].T.reshape(-1, 3, 3)
        covariance = covariance + forest.covariances[closings]
        motions, before = self.motions[closings], forest.poses[database]
        left = np.column_stack([_turned(motions[:, :2], before[:, 2]), motions[:, 2]])
        left += before - forest.poses[query]
        left[:, 2] = np.arctan2(np.sin(left[:, 2]), np.cos(left[:, 2]))
        squared = (left * np.linalg.solve(covariance, left[..., None])[..., 0]).sum(axis=1)
        peak = gamma((FREEDOM + 3) / 2) / gamma(FREEDOM / 2) / (FREEDOM * pi) ** 1.5
        density = peak / np.sqrt(np.linalg.det(covariance))
        density *= (1 + squared / FREEDOM) ** (-(FREEDOM + 3) / 2)
        return density * WINDOW * self.scale**2, np.hypot(left[:, 0], left[:, 1])

    def weigh(self, forest: "_Forest") -> tuple[Float[Array, "m"], Bool[NDArray[np.bool_], "m"]]:
        """Compute what the cycles say of each motion; see `weigh_others`.

        Returns:
            The support of each, and whether it leads to another place than the others do.
        """
        support, elsewhere = np.zeros(len(self.pairs)), np.zeros(len(self.pairs), bool)
        decided = np.zeros(len(self.pairs), bool)
        every = np.flatnonzero(~forest.joins)
        longest = 2 * int(forest.depth.max(initial=0)) + 1
        for closings in np.array_split(every, len(every) * longest // MOST_AT_ONCE + 1):
            paths = forest.paths(self.pairs[closings])
            likelihoods, gaps = self.close(closings, paths, forest)
            whole = self.chances[closings] + np.bincount(
                paths.cycles, self.chances[paths.links], minlength=len(closings)
            )
            # A link of the forest is weighed by the first cycle that it is part of.
            links, first = np.unique(paths.links, return_index=True)
            waiting, cycles = links[~decided[links]], paths.cycles[first[~decided[links]]]
            decided[waiting] = True
            weighed = np.concatenate([closings, waiting])
            by = np.concatenate([np.arange(len(closings)), cycles])
            wrong = np.clip(whole[by] - self.chances[weighed], 1e-12, MOST_WRONG)
            support[weighed] = np.log10((1 - wrong) * likelihoods[by] + wrong)
            elsewhere[closings] = (support[closings] < CONTRADICTED) & (gaps > APART * self.scale)
        return support, elsewhere

    def count_places(self, forest: "_Forest") -> dict[int, int]:
        """Count the places at which motions put each submap of the forest."""
        likely = self.chances <= 10 ** (TRIED_BESIDE - PLACE_SCORE)
        query, database = self.pairs[likely].T
        offset, yaw = self.motions[likely, :2], self.motions[likely, 2]
        # T_other_submap of the query is the motion, and of the database its inverse.
        offsets = np.stack([offset, -_turned(offset, -yaw)], axis=1).reshape(-1, 2)
        other = forest.poses[np.column_stack([database, query]).ravel()]
        where = (other[:, :2] + _turned(offsets, other[:, 2])).tolist()
        apart, places = APART * self.scale, dict[int, list[list[float]]]()
        for submap, (x, y) in zip(
            np.column_stack([query, database]).ravel().tolist(), where, strict=True
        ):
            others = places.setdefault(submap, [])
            if all(hypot(x - earlier_x, y - earlier_y) > apart for earlier_x, earlier_y in others):
                others.append([x, y])
        return {submap: len(several) for submap, several in places.items()}


@dataclass(frozen=True, eq=False)
class _Forest:
    """The links that join all submaps without a cycle, the best first.

    Attributes:
        joins: Which links are part of it (m,).
        poses: x [m], y [m] and yaw [rad] of each submap in the frame of its tree (n, 3).
        parent: The submap through which each was joined (n,); itself at a root.
        link: The link to that (n,).
        depth: Number of links to the root (n,).
        covariances: Of the motions of all links (m, 3, 3), turned as the tree lies.
    """

    joins: Bool[NDArray[np.bool_], "m"]
    poses: Float[Array, "n 3"]
    parent: Int[NDArray[np.intp], "n"]
    link: Int[NDArray[np.intp], "n"]
    depth: Int[NDArray[np.intp], "n"]
    covariances: Float[Array, "m 3 3"]

    @classmethod
    def of(cls, links: _Links) -> "_Forest":
        """Join submaps in the order of the links (Kruskal), and lay each tree out from a root."""
        count = int(links.pairs.max(initial=-1)) + 1
        joins, tree = np.zeros(len(links.pairs), bool), list(range(count))
        beside: list[list[tuple[int, int]]] = [[] for _ in range(count)]

        def root(submap: int) -> int:
            while tree[submap] != submap:
                tree[submap] = tree[tree[submap]]
                submap = tree[submap]
            return submap

        for k, (query, database) in enumerate(links.pairs.tolist()):
            first, second = root(query), root(database)
            if first != second:
                tree[first], joins[k] = second, True
                beside[query].append((database, k))
                beside[database].append((query, k))
        parent, link, depth = [-1] * count, [-1] * count, [0] * count
        poses: list[SE2] = [SE2()] * count
        for start in range(count):
            if parent[start] >= 0:
                continue
            parent[start], waiting = start, deque([start])
            while waiting:
                submap = waiting.popleft()
                for other, k in beside[submap]:
                    if parent[other] >= 0:
                        continue
                    motion = SE2(*links.motions[k].tolist())
                    if links.pairs[k, 0] == submap:
                        motion = motion.inverse()
                    poses[other] = poses[submap] @ motion
                    parent[other], link[other], depth[other] = submap, k, depth[submap] + 1
                    waiting.append(other)
        laid_out = np.array([(pose.x, pose.y, pose.yaw) for pose in poses]).reshape(-1, 3)
        turn = laid_out[links.pairs[:, 1], 2]
        frames = np.zeros((len(turn), 3, 3))
        frames[:, 0, 0] = frames[:, 1, 1] = np.cos(turn)
        frames[:, 1, 0] = np.sin(turn)
        frames[:, 0, 1] = -frames[:, 1, 0]
        frames[:, 2, 2] = 1.0
        covariances = frames @ links.covariances @ np.swapaxes(frames, -1, -2)
        above, by, deep = np.array([parent, link, depth], np.intp)
        return cls(joins, laid_out, above, by, deep, covariances)

    def paths(self, ends: Int[NDArray[np.intp], "c 2"]) -> "_Paths":
        """List the links between pairs of submaps of a tree."""
        first, second = ends.T.copy()
        cycles, links = [np.empty(0, np.intp)], [np.empty(0, np.intp)]
        going = np.flatnonzero(first != second)
        while len(going):
            deeper, other = first[going], second[going]
            swapped = self.depth[deeper] < self.depth[other]
            deeper, other = np.where(swapped, (other, deeper), (deeper, other))
            cycles.append(going)
            links.append(self.link[deeper])
            first[going], second[going] = self.parent[deeper], other
            going = going[first[going] != other]
        of_all = np.concatenate(cycles)
        order = np.argsort(of_all, kind="stable")
        return _Paths(of_all[order], np.concatenate(links)[order])


@dataclass(frozen=True, eq=False)
class _Paths:
    """The links between the ends of some cycles, one cycle after the other.

    Attributes:
        cycles: The number of the cycle of which each link is a part (k,), ascending.
        links: The links (k,).
    """

    cycles: Int[NDArray[np.intp], "k"]
    links: Int[NDArray[np.intp], "k"]
