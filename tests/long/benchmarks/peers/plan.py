"""Which cases are measured, with which methods, and what ours is to reach."""

from dataclasses import dataclass
from typing import Literal

from tests.long.benchmarks.peers.adapters import DENSE, OURS, PEERS, SKI_TRIED
from tests.long.benchmarks.peers.cases import Case
from tests.long.benchmarks.peers.measure import Caps

PartName = Literal["table", "ski", "points", "area", "targets"]


@dataclass(frozen=True)
class Part:
    """Some methods on some cases.

    Attributes:
        title: Above its table.
        cases: From the smallest to the largest.
        methods: By name.
        caps: That end a run.
        growing: Whether a method that goes over a cap is spared the larger cases.
        dense_cases: Those that the oracle is run on, for the errors; None: as any other method.
    """

    title: str
    cases: tuple[Case, ...]
    methods: tuple[str, ...]
    caps: Caps
    growing: bool = False
    dense_cases: tuple[Case, ...] | None = None


@dataclass(frozen=True)
class Target:
    """What ours is to reach on a case, on 2 cores."""

    case: Case
    milliseconds: float
    megabytes: float | None = None
    times_dense: float | None = None  # faster than the dense form
    elevation: float | None = None  # errors, as in `Errors`
    slope: float | None = None
    std_trusted: float | None = None
    std_anywhere: float | None = None


def target_at(length_scale: float, milliseconds: float) -> Target:
    """Say what a slider needs on the paper's kind of submap."""
    case = Case(5000, length_scale=length_scale)
    return Target(case, milliseconds, 300, 300, 0.01, 0.005, 0.02, 0.05)


TARGETS = (
    target_at(0.1, 200),
    target_at(0.3, 150),
    target_at(0.5, 200),
    Target(Case(30_000), 300),
    Target(Case(1_000_000), 5000, 2000),
    Target(Case(500_000, side=100.0, resolution=0.1), 15_000),
)
WITH_ORACLE = tuple(target.case for target in TARGETS if target.elevation is not None)


def at_density(sides: tuple[float, ...], resolution: float) -> tuple[Case, ...]:
    """Squares of different sides [m], all with 50 points a square metre."""
    return tuple(Case(round(50 * side**2), side, resolution) for side in sides)


def full_plan(table_seconds: float, growth_seconds: float) -> dict[PartName, Part]:
    """Lay out the measurement that is reported."""
    submap = Case(5000)
    numbers = (1000, 2000, 5000, 10_000, 30_000, 100_000, 300_000, 1_000_000)
    ski = tuple(settings.name for settings in SKI_TRIED)
    return {
        "table": Part(
            "5,000 points, 10 m x 10 m, 0.03 m/pixel, length-scale 0.3 m",
            (submap,),
            tuple(PEERS),
            Caps(table_seconds, 16_000),
        ),
        "ski": Part(
            "The same by GPyTorch SKI at other settings",
            (submap,),
            (OURS, DENSE, *ski),
            Caps(table_seconds, 16_000),
        ),
        "points": Part(
            "Seconds by the number of points: 10 m x 10 m, 0.03 m/pixel",
            tuple(Case(number) for number in numbers),
            tuple(PEERS),
            Caps(growth_seconds),
            growing=True,
        ),
        "area": Part(
            "Seconds by the area: 50 points/m², 0.1 m/pixel",
            at_density((5.0, 10.0, 20.0, 30.0, 50.0, 70.0, 100.0), 0.1),
            tuple(PEERS),
            Caps(growth_seconds),
            growing=True,
        ),
        "targets": Part(
            "What gpgrad is to reach",
            tuple(target.case for target in TARGETS),
            (OURS, DENSE),
            Caps(table_seconds, 16_000),
            dense_cases=WITH_ORACLE,
        ),
    }


def quick_plan() -> dict[PartName, Part]:
    """Lay out the same in small, to see that all of it works; its figures mean nothing."""
    few, more = Case(200, 2.0, 0.1), Case(900, 4.0, 0.1)  # more: above GPyTorch's Cholesky
    caps = Caps(60.0, 4000)
    ski = tuple(settings.name for settings in SKI_TRIED[:2])
    growing = (few, Case(400, 2.0, 0.1))
    return {
        "table": Part("900 points", (more,), tuple(PEERS), caps),
        "ski": Part("SKI at other settings", (more,), (OURS, DENSE, *ski), caps),
        "points": Part("Seconds by points", growing, tuple(PEERS), Caps(2.0), growing=True),
        "area": Part(
            "Seconds by area", at_density((2.0, 2.5), 0.1), tuple(PEERS), Caps(2.0), growing=True
        ),
        "targets": Part(
            "Targets, none of which is for these",
            (few, more),
            (OURS, DENSE),
            caps,
            dense_cases=(few,),
        ),
    }
