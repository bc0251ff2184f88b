"""What the other pairs of a dataset say about one: whether the ground repeats, and what agrees.

The guide explains it (method.md, *Three hypotheses*).
"""

from collections import defaultdict, deque
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import islice
from math import exp, gamma, hypot, inf, log, log2, log10, pi

import numpy as np
from jaxtyping import Bool, Float, Int

from gpgrad_core.arrays import Array, Indices, Mask
from gpgrad_core.se2 import SE2, move_covariance, turned_by
from gpgrad_core.types import Context, LoopClosure, Pair, Registration

USUAL_MISFIT, USUAL_WEIGHT = 0.85, 3.0
"""How many times the heights of one terrain usually differ more than the uncertainty of the maps
explains, and how many neighbours that counts as."""
MISFIT_SPREAD = 0.22
"""Spread of the logarithm of that within a dataset."""
SCORE_CAP = 2.0
"""Unusual heights leave half of a score, up to this."""
NEIGHBOUR_SCORE = 3.0
"""Neighbours with at least this score show what is usual."""
TRIED_BESIDE = 1.0
"""Logarithm of the number of pairs apart for each true one: a closure of score s is wrong with a
chance of 10^(this - s)."""
LEAST_LINK = 1.0
"""Lowest score of a pair that other pairs are compared with; below, it says nothing."""
NEXT = 0.5
"""What that is less for a submap and the next one: they mostly share ground."""
MOST_WRONG = 0.9
"""No link is more likely wrong than this."""
MOST_SUPPORT = 1.5
"""Other closures raise a score by no more than this, less what unusual heights take off it."""
WINDOW = 2.0
"""Where a slightly wrong motion of the right place may lie [scales² rad]: 1.2 scales to either side
along x and y, and 10 degrees."""
LEAST_STD, LEAST_YAW_STD = 0.1, 0.003
"""Standard deviations of a motion beyond what its registration says [scales], [rad]."""
FREEDOM = 3.0
"""Degrees of freedom of Student's t, the distribution of what is left when a cycle is closed."""
ODOMETRY_DRIFT, ODOMETRY_TURN, ODOMETRY_SCORE = 0.05, 0.02, 4.0
"""Standard deviations of odometry per distance driven [m/m] and in heading [rad]; and the score
that it counts as."""
APART, PLACE_SCORE = 3.0, 2.5
"""Places of a submap count as two if they are further apart than this [scales]; and motions count
as places from this score on."""
CONTRADICTED = -0.3
"""A motion with less support than this, and that far off, leads to another place."""
LEAD, REPEATED, USUAL = 2.0, (0.2, 0.35), 1.3
"""A closure may have this score where a rival place fits as well, if of the closures with heights
within `USUAL` times what is usual at most the first share of `REPEATED` leads elsewhere. From the
second share on it needs all of its score as a lead."""
USUAL_GAP, MOST_GAP = 0.33, 10.0
"""Mean square of what is left when three motions close a triangle, relative to their covariances,
where these are right: what is wrong with a submap moves both of its motions alike and does not
show. And the most that one triangle counts."""
GAPS_TOLD, FEW_GAPS = 0.6, 5
"""Variances follow the mean square of a dataset to this power, and with so many triangles to half
of it."""
FACTOR_STEPS, MOST_FACTOR = 4, 4.0
"""Steps of a variance factor from one to twice that: finer ones would change it all the time. And
the most that it is. It is at least one: triangles that close well may share what is wrong."""

ORIGIN = SE2()
"""Where the first submap of each tree lies."""
MOST_AT_ONCE = 100_000
"""Links of cycles, or triangles, that are computed at once, in some 50 MB."""


class Contexts(Mapping[Pair, Context]):
    """The context of each pair whose terrain was compared; each is made when it is needed."""

    def __init__(
        self,
        rows: Mapping[Pair, tuple[float, float, float, float, int]],
        variance_factor: float = 1.0,
    ) -> None:
        self._rows, self.variance_factor = rows, variance_factor

    def __getitem__(self, pair: Pair) -> Context:
        return Context(*self._rows[pair], self.variance_factor)

    def __iter__(self) -> Iterator[Pair]:
        return iter(self._rows)

    def __len__(self) -> int:
        return len(self._rows)

    @cached_property
    def scores(self) -> Mapping[Pair, float]:
        """The scores with what the others say."""
        return {pair: row[1] for pair, row in self._rows.items()}


class Consistency:
    """Weighs each pair of a dataset, which may grow, by all the others.

    A score is the logarithm of a chance, so what is added to it are logarithms too:

    - Of a pair whose heights differ by z usual spreads more than is usual, -z² / 2, as a natural
      logarithm: so much less likely is that difference on one terrain.
    - The pairs are joined to a forest, those of the highest scores first. Every other pair closes a
      cycle. With d what is left when the cycle is closed, C its covariance and ε the chance that
      another motion of the cycle is wrong, the motion is more likely than a slightly wrong one of
      the same place by

          log10((1 - ε) t(d; C) / min(1 / WINDOW, t(0; C)) + ε)

      A pair of the forest is weighed by the cycle of the best pair that could replace it. A cycle
      is computed anew only if its way through the forest has changed.
    - A score is worth no more than how rare it is among pairs that lead elsewhere.

    The covariances of a dataset's motions are multiplied by one factor, which its triangles show.
    """

    def __init__(self) -> None:
        self._num_processed = 0
        self._compared = _Compared.of({})
        self._odometry = _OdometrySteps()
        self._triangles = _Triangles()
        self._forest: _Forest | None = None
        self._cycles = _Cycles(np.zeros(0, bool), np.zeros(0), np.zeros(0), 0.0)

    def weigh(
        self,
        registrations: Mapping[Pair, Registration],
        odometry: Sequence[SE2 | None] = (),
        centres: Sequence[Float[Array, "3"]] = (),
    ) -> Contexts:
        """Weigh the pairs (query, database), of which those of the last time come first."""
        new = dict(islice(registrations.items(), self._num_processed, None))
        self._num_processed = len(registrations)
        compared = self._compared = self._compared.joined(_Compared.of(new, centres))
        self._triangles.add(compared)
        self._odometry.add(odometry, centres)
        misfits, against = compared.unusual()
        scores = np.maximum(compared.scores - against, 0.0)
        links = _Links.of(compared, scores, self._odometry)
        self._forest = forest = _Forest.of(links, self._forest)
        self._cycles = self._cycles.grown(len(scores), links.scale)
        support, leads_elsewhere = links.weigh(forest, self._cycles)
        # What the cycles say of odometry says nothing of the pair that it leads through.
        linked = links.numbers[links.is_pair]
        support_by_cycles, elsewhere = np.zeros(len(scores)), np.zeros(len(scores), bool)
        support_by_cycles[linked] = support[links.is_pair]
        elsewhere[linked] = leads_elsewhere[links.is_pair]
        shown = _most_shown(scores, scores[elsewhere], len(registrations))
        supported = np.maximum(shown, np.minimum(compared.scores / 2, SCORE_CAP))
        raised = np.minimum(support_by_cycles, np.maximum(MOST_SUPPORT - against, 0.0))
        rivals = _most_beside_rivals(compared.pairs, linked, scores, elsewhere, misfits)
        weighed = np.maximum(np.minimum(supported + raised, rivals), 0.0)
        places = links.count_places(forest)
        several = [
            max(places.get(query, 1), places.get(database, 1))
            for query, database in compared.pairs.tolist()
        ]
        columns = (compared.scores, weighed, misfits, support_by_cycles)
        rows = zip(*(column.tolist() for column in columns), several, strict=True)
        pairs = map(tuple, compared.pairs.tolist())
        factor = self._triangles.variance_factor(weighed)
        return Contexts(dict(zip(pairs, rows, strict=True)), factor)


def _most_shown(
    scores: Float[Array, "n"], wrong: Float[Array, "k"], num_pairs: int
) -> Float[Array, "n"]:
    """Limit scores: if N of n pairs that lead elsewhere reach one, to log10(n / (N - 1))."""
    reached = len(wrong) - np.searchsorted(np.sort(wrong), scores)
    most = [inf, inf, *(log10(num_pairs / more) for more in range(1, len(wrong)))]
    return np.minimum(scores, np.array(most)[reached])


def _most_beside_rivals(
    pairs: Int[Indices, "n 2"],
    linked: Int[Indices, "m"],
    scores: Float[Array, "n"],
    elsewhere: Bool[Mask, "n"],
    misfits: Float[Array, "n"],
) -> Float[Array, "n"]:
    """Limit scores by the lead over closures that put the same submaps elsewhere."""
    here, away = np.zeros((2, int(pairs.max(initial=-1)) + 1))
    places = scores[linked] >= PLACE_SCORE
    leads = elsewhere[linked]
    for best, some in ((here, linked[~leads]), (away, linked[leads & places])):
        for side in (0, 1):
            np.maximum.at(best, pairs[some, side], scores[some])
    usual = leads[places & (misfits[linked] <= USUAL)]
    repeated = int(usual.sum()) / max(len(usual), 1)
    low, high = REPEATED
    lead = LEAD * min(max((high - repeated) / (high - low), 0.0), 1.0)
    ahead = np.where(away > 0, here - away, inf)
    return np.minimum(ahead[pairs[:, 0]], ahead[pairs[:, 1]]) + lead


def in_context(registration: Registration, context: Context | None) -> Registration:
    """Give a registration the score and the covariance that count beside the other pairs."""
    if context is None:
        return registration
    return _changed(registration, context.score, context.variance_factor)


def own_registration(closure: LoopClosure) -> Registration:
    """The registration of a closure as it is for the pair alone."""
    context = closure.context
    if context is None:
        return closure.registration
    return _changed(closure.registration, context.own_score, 1 / context.variance_factor)


def _changed(registration: Registration, score: float, factor: float) -> Registration:
    covariance = registration.covariance
    covariance = None if covariance is None else factor * covariance
    return replace(registration, score=score, covariance=covariance)


def score_against(misfit: float) -> float:
    """Compute what heights that differ so many times more than is usual take off a score."""
    return max(log(misfit) / MISFIT_SPREAD, 0.0) ** 2 / 2 / log(10)


def _misfit(registration: Registration) -> float:
    agreement = registration.agreement
    assert agreement is not None
    return max(agreement.difference, 1e-9) / max(agreement.possible, 1e-9)


@dataclass(frozen=True, eq=False)
class _Compared:
    pairs: Int[Indices, "n 2"]  # query and database of each (n, 2)
    scores: Float[Array, "n"]  # of the pairs alone (n,)
    ratios: Float[Array, "n"]  # logarithm of how much the heights differ (n,), see `_misfit`
    has_motion: Bool[Mask, "n"]  # whether a motion and its covariance are known (n,)
    # x [m], y [m] and yaw [rad] of ``T_database_query`` (n, 3), between frames whose origins are
    # the centres of the submaps
    motions: Float[Array, "n 3"]
    covariances: Float[Array, "n 3 3"]  # of the motions (n, 3, 3)
    scales: Float[Array, "n"]  # scale of comparison [m] (n,); 0 if it is not known

    @classmethod
    def of(
        cls, registrations: Mapping[Pair, Registration], centres: Sequence[Float[Array, "3"]] = ()
    ) -> "_Compared":
        some = {pair: one for pair, one in registrations.items() if one.agreement is not None}
        chosen = some.values()
        pairs = np.array([*some], np.intp).reshape(-1, 2)
        motions = np.array(
            [
                (motion.x, motion.y, motion.yaw)
                for motion in (one.T_database_query or SE2() for one in chosen)
            ]
        ).reshape(-1, 3)
        unknown = np.zeros((3, 3))
        covariances = np.array(
            [unknown if one.covariance is None else one.covariance for one in chosen], np.float64
        ).reshape(-1, 3, 3)
        ends = np.zeros((2, len(pairs), 2))
        if len(centres):
            ends = np.array(centres)[pairs.T, :2]
        has_motion = np.array([one.T_database_query is not None for one in chosen], bool)
        has_motion &= np.array([one.covariance is not None for one in chosen], bool)
        has_motion &= np.isfinite(covariances).all(axis=(1, 2))
        # From here on between the centres, with the covariance at the query's.
        placed = turned_by(ends[0], motions[:, 2]) + motions[:, :2]
        origins = motions[:, :2].tolist()
        middles = [one.overlap_middle or at for one, at in zip(chosen, origins, strict=True)]
        arms = placed - np.array(middles, np.float64).reshape(-1, 2)
        covariances = move_covariance(covariances, arms)
        motions[:, :2] = placed - ends[1]
        return cls(
            pairs,
            np.array([one.score for one in chosen], np.float64),
            np.array([log(_misfit(one)) for one in chosen], np.float64),
            has_motion,
            motions,
            covariances,
            np.array([one.scale or 0.0 for one in chosen], np.float64),
        )

    def joined(self, more: "_Compared") -> "_Compared":
        return _Compared(
            *(
                np.concatenate(both)
                for both in zip(vars(self).values(), vars(more).values(), strict=True)
            )
        )

    def gaps(self, triangles: Int[Indices, "t 3"]) -> Float[Array, "t"]:
        """Mean squares of what is left when triangles are closed, relative to their covariances.

        The pairs of a triangle lead from its last submap by its middle one to its first, and there
        directly.
        """
        to_middle, onward, direct = triangles.T
        yaw = self.motions[onward, 2]
        arms = turned_by(self.motions[to_middle, :2], yaw)
        gap = self.motions[to_middle] + self.motions[onward] - self.motions[direct]
        gap[:, :2] = arms + self.motions[onward, :2] - self.motions[direct, :2]
        gap[:, 2] = np.arctan2(np.sin(gap[:, 2]), np.cos(gap[:, 2]))
        covariance = (
            _turned(self.covariances[to_middle], yaw)
            + move_covariance(self.covariances[onward], arms)
            + self.covariances[direct]
            + 1e-12 * np.eye(3)  # a micrometre: no motion is more exact
        )
        return (gap * np.linalg.solve(covariance, gap[..., None])[..., 0]).sum(axis=1) / 3

    def unusual(self) -> tuple[Float[Array, "n"], Float[Array, "n"]]:
        follows = self.pairs[:, 0] - self.pairs[:, 1] == 1
        shown = self.ratios[follows & (self.scores >= NEIGHBOUR_SCORE)]
        usual = log(USUAL_MISFIT)
        if len(shown):
            # Where the ground repeats, neighbours may have wrong motions, which differ more. So the
            # middle is taken from the fifth that differs least.
            middle = float(np.quantile(shown, 0.2)) + 0.84 * MISFIT_SPREAD
            usual += (middle - usual) * len(shown) / (len(shown) + USUAL_WEIGHT)
        misfits = [exp(ratio - usual) for ratio in self.ratios.tolist()]
        against = [score_against(misfit) if misfit > 1 else 0.0 for misfit in misfits]
        return np.array(misfits, np.float64), np.array(against, np.float64)


class _Triangles:
    """Motions between each two of three submaps: their errors show when they close a triangle."""

    def __init__(self) -> None:
        self._sides: dict[Pair, int] = {}  # the number of each pair that may be one
        self._beside: defaultdict[int, set[int]] = defaultdict(set)  # the other ends of these
        self._num_processed = 0
        self._triangles = np.empty((0, 3), np.intp)  # by the numbers of their pairs
        self._gaps = np.empty(0)  # see `_Compared.gaps`

    def add(self, compared: _Compared) -> None:
        """Close the triangles of new pairs; those of the last time come first."""
        earlier, self._num_processed = self._num_processed, len(compared.pairs)
        possible = compared.has_motion & (compared.scores >= LEAST_LINK)
        possible &= compared.pairs[:, 0] > compared.pairs[:, 1]
        closed: list[tuple[int, ...]] = []
        for number in (np.flatnonzero(possible[earlier:]) + earlier).tolist():
            query, database = compared.pairs[number].tolist()
            self._sides[query, database] = number
            for third in self._beside[query] & self._beside[database]:
                first, middle, last = sorted((query, database, third))
                sides = (last, middle), (middle, first), (last, first)
                closed.append(tuple(self._sides[side] for side in sides))
            self._beside[query].add(database)
            self._beside[database].add(query)
        new = np.array(closed, np.intp).reshape(-1, 3)
        parts = np.array_split(new, len(new) // MOST_AT_ONCE + 1)
        self._triangles = np.concatenate([self._triangles, new])
        self._gaps = np.concatenate([self._gaps, *map(compared.gaps, parts)])

    def variance_factor(self, scores: Float[Array, "n"]) -> float:
        """How many times larger variances are than the registrations say, by what is likely."""
        likely = (scores[self._triangles] >= NEIGHBOUR_SCORE).all(axis=1)
        gaps = np.clip(self._gaps[likely], 1e-12, MOST_GAP)
        if not len(gaps):
            return 1.0
        power = GAPS_TOLD * len(gaps) / (len(gaps) + FEW_GAPS)
        factor = (float(gaps.mean()) / USUAL_GAP) ** power
        factor = min(max(factor, 1.0), MOST_FACTOR)
        return 2.0 ** (round(FACTOR_STEPS * log2(factor)) / FACTOR_STEPS)


class _OdometrySteps:
    """The motions from one submap to the next by odometry."""

    def __init__(self) -> None:
        self._last: SE2 | None = None
        self._num_processed = 0
        self.pairs: list[Pair] = []
        self.motions: list[SE2] = []
        self.covariances: list[Float[Array, "3 3"]] = []

    def add(
        self, odometry: Sequence[SE2 | None], centres: Sequence[Float[Array, "3"]] = ()
    ) -> None:
        for k, pose in enumerate(odometry[self._num_processed :], self._num_processed):
            after = pose and (pose @ SE2(*centres[k][:2].tolist()) if len(centres) else pose)
            before, self._last = self._last, after
            if before is not None and after is not None:
                step = before.inverse() @ after
                off = ODOMETRY_DRIFT * float(np.hypot(step.x, step.y))
                self.pairs.append((k, k - 1))
                self.motions.append(step)
                self.covariances.append(np.diag([off**2, off**2, ODOMETRY_TURN**2]))
        self._num_processed = len(odometry)


@dataclass(frozen=True, eq=False)
class _Links:
    """The motions that can be part of a cycle, the one with the highest score first."""

    # of the pairs of each among all that were compared (m,), or of odometry's motions
    numbers: Int[Indices, "m"]
    pairs: Int[Indices, "m 2"]  # the submaps of each (m, 2): query and database
    motions: Float[Array, "m 3"]  # x [m], y [m] and yaw [rad] of ``T_database_query`` (m, 3)
    covariances: Float[Array, "m 3 3"]  # of the motions (m, 3, 3)
    chances: Float[Array, "m"]  # that a motion is wrong (m,)
    is_pair: Bool[Mask, "m"]  # whether it is a pair's motion (m,), and not odometry's
    scale: float  # scale of comparison [m]

    @classmethod
    def of(
        cls, compared: _Compared, scores: Float[Array, "n"], odometry: _OdometrySteps
    ) -> "_Links":
        some = np.flatnonzero(compared.has_motion & (scores >= LEAST_LINK))
        steps = [(step.x, step.y, step.yaw) for step in odometry.motions]
        pairs = np.concatenate(
            [compared.pairs[some], np.array(odometry.pairs, np.intp).reshape(-1, 2)]
        )
        follows = pairs[: len(some), 0] - pairs[: len(some), 1] == 1
        worth = np.concatenate(
            [scores[some] + np.where(follows, NEXT, 0.0), np.full(len(steps), ODOMETRY_SCORE)]
        )
        is_pair = np.arange(len(pairs)) < len(some)
        order = np.lexsort((is_pair, pairs[:, 1], pairs[:, 0], -worth))
        scales = compared.scales[compared.scales != 0]
        scale = float(np.median(scales)) if len(scales) else 1.0
        beyond = np.diag([(LEAST_STD * scale) ** 2, (LEAST_STD * scale) ** 2, LEAST_YAW_STD**2])
        own = np.array(odometry.covariances).reshape(-1, 3, 3)
        return cls(
            np.concatenate([some, np.arange(len(steps))])[order],
            pairs[order],
            np.concatenate([compared.motions[some], np.array(steps).reshape(-1, 3)])[order],
            np.concatenate([compared.covariances[some], own])[order] + beyond,
            np.minimum(10.0 ** (TRIED_BESIDE - worth[order]), MOST_WRONG),
            is_pair[order],
            scale,
        )

    def close(
        self, closings: Int[Indices, "c"], paths: "_Paths", forest: "_Forest"
    ) -> tuple[Float[Array, "c"], Float[Array, "c"]]:
        """Compute likelihoods of cycles relative to slightly wrong motions, and their gaps [m]."""
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
        left = np.column_stack([turned_by(motions[:, :2], before[:, 2]), motions[:, 2]])
        left += before - forest.poses[query]
        left[:, 2] = np.arctan2(np.sin(left[:, 2]), np.cos(left[:, 2]))
        squared = (left * np.linalg.solve(covariance, left[..., None])[..., 0]).sum(axis=1)
        peak = gamma((FREEDOM + 3) / 2) / gamma(FREEDOM / 2) / (FREEDOM * pi) ** 1.5
        most = peak / np.sqrt(np.linalg.det(covariance))
        density = most * (1 + squared / FREEDOM) ** (-(FREEDOM + 3) / 2)
        # A long cycle closes less exactly than a slightly wrong motion is off: it tells only
        # whether what is left is as large as expected.
        beside = np.minimum(1 / (WINDOW * self.scale**2), most)
        return density / beside, np.hypot(left[:, 0], left[:, 1])

    def weigh(
        self, forest: "_Forest", cycles: "_Cycles"
    ) -> tuple[Float[Array, "m"], Bool[Mask, "m"]]:
        """Compute each motion's support by the cycles, and whether it leads elsewhere."""
        support, elsewhere = np.zeros(len(self.pairs)), np.zeros(len(self.pairs), bool)
        decided = np.zeros(len(self.pairs), bool)
        every = np.flatnonzero(~forest.joins)
        longest = 2 * int(forest.depth.max(initial=0)) + 1
        stale = ~(self.is_pair & forest.stays[self.pairs].all(axis=1))
        stale[~stale] = ~cycles.current[self.numbers[~stale]]
        for closings in np.array_split(every, len(every) * longest // MOST_AT_ONCE + 1):
            paths = forest.paths(self.pairs[closings])
            likelihoods, gaps = self._closed(closings, paths, forest, cycles, stale[closings])
            whole = self.chances[closings] + np.bincount(
                paths.cycles, self.chances[paths.links], minlength=len(closings)
            )
            # A link of the forest is weighed by the first cycle that it is part of.
            first = np.full(len(self.pairs), len(closings))
            np.minimum.at(first, paths.links, paths.cycles)
            waiting = np.flatnonzero((first < len(closings)) & ~decided)
            decided[waiting] = True
            weighed = np.concatenate([closings, waiting])
            by = np.concatenate([np.arange(len(closings)), first[waiting]])
            wrong = np.clip(whole[by] - self.chances[weighed], 1e-12, MOST_WRONG)
            support[weighed] = np.log10((1 - wrong) * likelihoods[by] + wrong)
            elsewhere[closings] = (support[closings] < CONTRADICTED) & (gaps > APART * self.scale)
        cycles.current[:] = False  # but of those that are closed now
        cycles.current[self.numbers[every[self.is_pair[every]]]] = True
        return support, elsewhere

    def _closed(
        self,
        closings: Int[Indices, "c"],
        paths: "_Paths",
        forest: "_Forest",
        cycles: "_Cycles",
        stale: Bool[Mask, "c"],
    ) -> tuple[Float[Array, "c"], Float[Array, "c"]]:
        """As `close`, but only cycles that changed are computed."""
        likelihoods, gaps = np.empty((2, len(closings)))
        unchanged = self.numbers[closings[~stale]]
        likelihoods[~stale], gaps[~stale] = cycles.likelihoods[unchanged], cycles.gaps[unchanged]
        some = stale[paths.cycles]
        new = _Paths((np.cumsum(stale) - 1)[paths.cycles[some]], paths.links[some])
        likelihoods[stale], gaps[stale] = self.close(closings[stale], new, forest)
        pairs = stale & self.is_pair[closings]
        numbers = self.numbers[closings[pairs]]
        cycles.likelihoods[numbers], cycles.gaps[numbers] = likelihoods[pairs], gaps[pairs]
        return likelihoods, gaps

    def count_places(self, forest: "_Forest") -> dict[int, int]:
        """Count the places at which motions put each submap of the forest, where several."""
        likely = self.chances <= 10 ** (TRIED_BESIDE - PLACE_SCORE)
        query, database = self.pairs[likely].T
        offset, yaw = self.motions[likely, :2], self.motions[likely, 2]
        # T_other_submap of the query is the motion, and of the database its inverse.
        offsets = np.stack([offset, -turned_by(offset, -yaw)], axis=1).reshape(-1, 2)
        other = forest.poses[np.column_stack([database, query]).ravel()]
        where = other[:, :2] + turned_by(offsets, other[:, 2])
        submaps = np.column_stack([query, database]).ravel()
        apart, places = APART * self.scale, dict[int, list[list[float]]]()
        # Mostly all lie beside the first one.
        _, first, which = np.unique(submaps, return_index=True, return_inverse=True)
        away = np.linalg.norm(where - where[first[which]], axis=1) > 0.99 * apart
        some = np.isin(submaps, submaps[away])
        for submap, (x, y) in zip(submaps[some].tolist(), where[some].tolist(), strict=True):
            others = places.setdefault(submap, [])
            if all(hypot(x - earlier_x, y - earlier_y) > apart for earlier_x, earlier_y in others):
                others.append([x, y])
        return {submap: len(several) for submap, several in places.items()}


@dataclass(frozen=True, eq=False)
class _Cycles:
    current: Bool[Mask, "n"]  # whether the value of each pair is up to date (n,)
    likelihoods: Float[Array, "n"]  # see `_Links.close` (n,)
    gaps: Float[Array, "n"]  # by how much each does not close [m] (n,)
    scale: float  # scale of comparison [m] by which it was computed

    def grown(self, count: int, scale: float) -> "_Cycles":
        """Make room for more pairs; with another scale no value is current."""
        more = np.zeros(count - len(self.current))
        is_current = np.concatenate(
            [self.current & (scale == self.scale), np.zeros(len(more), bool)]
        )
        likelihoods = np.concatenate([self.likelihoods, more])
        return _Cycles(is_current, likelihoods, np.concatenate([self.gaps, more]), scale)


@dataclass(frozen=True, eq=False)
class _Forest:
    """The links that join all submaps without a cycle, the best first."""

    joins: Bool[Mask, "m"]  # which links are part of it (m,)
    # x [m], y [m] and yaw [rad] of each submap in the frame of its tree (n, 3)
    poses: Float[Array, "n 3"]
    # the submap through which each was joined (n,); itself at a root
    parent: Int[Indices, "n"]
    link: Int[Indices, "n"]  # the link to that (n,)
    depth: Int[Indices, "n"]  # number of links to the root (n,)
    # of the motions of all links (m, 3, 3), turned as the tree lies
    covariances: Float[Array, "m 3 3"]
    # by which way each was laid out: its pose, and whether a pair's motion led to it
    ways: list[tuple[SE2, bool]]
    stays: Bool[Mask, "n"]  # whether that is the way of the forest before (n,)

    @classmethod
    def of(cls, links: _Links, last: "_Forest | None" = None) -> "_Forest":
        """Join submaps in the order of the links (Kruskal), and lay each tree out from a root."""
        count = int(links.pairs.max(initial=-1)) + 1
        joins, tree = np.zeros(len(links.pairs), bool), list(range(count))
        beside: list[list[tuple[int, int]]] = [[] for _ in range(count)]

        def root(submap: int) -> int:
            while tree[submap] != submap:
                tree[submap] = tree[tree[submap]]
                submap = tree[submap]
            return submap

        apart = len(np.unique(links.pairs)) - 1
        for k, (query, database) in enumerate(links.pairs.tolist()):
            first, second = root(query), root(database)
            if first != second:
                tree[first], joins[k] = second, True
                apart -= 1
                beside[query].append((database, k))
                beside[database].append((query, k))
                if not apart:
                    break
        parent, link, depth = [-1] * count, [-1] * count, [0] * count
        ways, stays = [(ORIGIN, False)] * count, np.zeros(count, bool)
        before = dict(
            enumerate(() if last is None else zip(last.parent.tolist(), last.ways, strict=True))
        )
        for start in range(count):
            if parent[start] >= 0:
                continue
            parent[start], waiting = start, deque([start])
            stays[start] = start in before and before[start][0] == start
            while waiting:
                submap = waiting.popleft()
                for other, k in beside[submap]:
                    if parent[other] >= 0:
                        continue
                    parent[other], link[other], depth[other] = submap, k, depth[submap] + 1
                    waiting.append(other)
                    by_pair = bool(links.is_pair[k])
                    if stays[submap] and other in before:
                        earlier, way = before[other]
                        stays[other] = earlier == submap and way[1] == by_pair
                        if stays[other]:
                            ways[other] = way
                            continue
                    motion = SE2(*links.motions[k].tolist())
                    if links.pairs[k, 0] == submap:
                        motion = motion.inverse()
                    ways[other] = ways[submap][0] @ motion, by_pair
        xy_yaw = np.array([(pose.x, pose.y, pose.yaw) for pose, _ in ways]).reshape(-1, 3)
        covariances = _turned(links.covariances, xy_yaw[links.pairs[:, 1], 2])
        above, by, deep = np.array([parent, link, depth], np.intp)
        return cls(joins, xy_yaw, above, by, deep, covariances, ways, stays)

    def paths(self, ends: Int[Indices, "c 2"]) -> "_Paths":
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
        return _Paths(np.concatenate(cycles), np.concatenate(links))


@dataclass(frozen=True, eq=False)
class _Paths:
    """The links between the ends of some cycles; those of each in their order along it."""

    cycles: Int[Indices, "k"]  # the number of the cycle of which each link is a part (k,)
    links: Int[Indices, "k"]  # the links (k,)


def _turned(covariances: Float[Array, "n 3 3"], yaw: Float[Array, "n"]) -> Float[Array, "n 3 3"]:
    """Covariances of x, y and yaw in frames that are turned by angles [rad]."""
    frames = np.zeros((len(yaw), 3, 3))
    frames[:, 0, 0] = frames[:, 1, 1] = np.cos(yaw)
    frames[:, 1, 0] = np.sin(yaw)
    frames[:, 0, 1] = -frames[:, 1, 0]
    frames[:, 2, 2] = 1.0
    return frames @ covariances @ np.swapaxes(frames, -1, -2)
