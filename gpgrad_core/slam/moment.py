"""One moment of a drive: what the submap that came then decided, and where all of them lie."""

from collections.abc import Iterable
from dataclasses import dataclass

from jaxtyping import Float

from gpgrad_core.detection.shortlist import Candidate
from gpgrad_core.se2 import Pose
from gpgrad_core.types import Array, LoopClosure, PairOfIds, read_only


@dataclass(frozen=True, eq=False)
class Moment:
    """What adding one submap decided, and the map as it was then.

    Attributes:
        submap_id: Id of the submap that was added.
        odometry: Its pose by odometry, ``T_odometry_submap``.
        starts_traverse: Whether it begins another traverse, to which no odometry leads.
        closures: The verdicts on it and each earlier submap that it was compared with.
        shortlist: The earlier submaps that it was compared with and why, the best first; None if
            it was compared with all that are near enough.
        turned: The new verdicts on earlier pairs that it has turned: from refused to accepted, or
            back.
        left_out: Accepted pairs of all so far that the solved graph contradicts, and leaves out.
        ids: Ids of all submaps so far, in their order; the new one is the last.
        places: Their corrected ``T_world_submap`` (n, 7): x, y, z [m], qx, qy, qz, qw.
        covariances: Covariance (n, 3, 3) of the x [m], y [m] and yaw [rad] of each, in the world.
        moved: Distance [m] by which this submap moved the earlier one that it moved the most.
    """

    submap_id: str
    odometry: Pose
    starts_traverse: bool
    closures: tuple[LoopClosure, ...]
    shortlist: tuple[Candidate, ...] | None
    turned: tuple[LoopClosure, ...]
    left_out: tuple[PairOfIds, ...]
    ids: tuple[str, ...]
    places: Float[Array, "n 7"]
    covariances: Float[Array, "n 3 3"]
    moved: float

    def __post_init__(self) -> None:
        read_only(self.places, self.covariances)

    @property
    def number(self) -> int:
        """Number of the submap in the drive, from 0."""
        return len(self.ids) - 1

    @property
    def poses(self) -> dict[str, Pose]:
        """Corrected ``T_world_submap`` of all submaps so far, by id."""
        return {
            name: Pose(row[:3].copy(), row[3:].copy())
            for name, row in zip(self.ids, self.places, strict=True)
        }

    @property
    def accepted(self) -> tuple[LoopClosure, ...]:
        """The loop closures of the new submap."""
        return tuple(closure for closure in self.closures if closure.accepted)

    @property
    def refused(self) -> tuple[LoopClosure, ...]:
        """The other pairs that it was compared in."""
        return tuple(closure for closure in self.closures if not closure.accepted)


def verdicts_at(moments: Iterable[Moment]) -> dict[PairOfIds, LoopClosure]:
    """Give the verdict on every pair as it was after the last of some moments."""
    verdicts: dict[PairOfIds, LoopClosure] = {}
    for moment in moments:
        for closure in (*moment.closures, *moment.turned):
            verdicts[closure.pair] = closure
    return verdicts
