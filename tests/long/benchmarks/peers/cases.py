"""What every method is asked, what it may answer, and how far the answer is from the oracle's."""

from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from gpgrad_core.arrays import Array
from gpgrad_core.types import Grid
from tests.support.ground import cloud

NOISE = 0.05
"""Standard deviation of a point's height [m]."""
TRUSTED = 0.3
"""Cells whose standard deviation, by the oracle, is at most this share of signal_std."""


@dataclass(frozen=True)
class Case:
    """A square cloud on random ground, and the grid to map it on.

    Attributes:
        num_points: In the cloud.
        side: Of the square [m].
        resolution: Side of a cell [m].
        length_scale: Of the GP [m]; all else that the GP is given is the same in every case.
    """

    num_points: int
    side: float = 10.0
    resolution: float = 0.03
    length_scale: float = 0.3

    @property
    def name(self) -> str:
        """One word for files and messages."""
        return f"{self.num_points}-{self.side:g}m-{self.resolution:g}-{self.length_scale:g}"

    @property
    def num_cells(self) -> int:
        """Of the grid."""
        return Grid.covering(np.array([[0.0, 0.0], [self.side] * 2]), self.resolution).num_cells

    def task(self) -> "Task":
        """Draw the cloud: the same one whenever it is asked for."""
        points = cloud(42, self.num_points, (self.side, self.side), noise=NOISE)
        points[:2, :2] = [[0.0, 0.0], [self.side] * 2]  # the whole box, to the corner
        return Task(self, points, float(points[:, 2].std()))


@dataclass(frozen=True, eq=False)
class Task:
    """A case with its points: what a method gets."""

    case: Case
    points: Array  # (n, 3) [m]
    signal_std: float  # [m]

    @property
    def xy(self) -> Array:
        """Positions (n, 2) [m]."""
        return self.points[:, :2]

    @property
    def mean(self) -> float:
        """Height that the zero-mean GP is relative to [m]."""
        return float(self.points[:, 2].mean())

    @property
    def heights(self) -> Array:
        """Relative to the mean, (n,) [m]."""
        return self.points[:, 2] - self.mean

    @property
    def length_scale(self) -> float:
        """Of the GP [m]."""
        return self.case.length_scale

    @property
    def grid(self) -> Grid:
        """The cells to map."""
        return Grid.covering(self.xy, self.case.resolution)

    def tiles(self, cells: int) -> list[Array]:
        """Cut the cells' positions into parts of at most so many, (q, 2) each [m]."""
        positions = self.grid.positions
        return np.array_split(positions, -(-len(positions) // cells))


@dataclass(frozen=True, eq=False)
class Answer:
    """The fields that a method gives; None where it has none."""

    elevation: Array  # (rows, columns) [m]
    std: Array | None = None  # of the elevation [m]
    slope: Array | None = None  # (rows, columns, 2) [m/m]

    @classmethod
    def of_cells(
        cls, task: Task, elevation: Array, variance: Array | None = None, slope: Array | None = None
    ) -> "Answer":
        """Shape what came cell by cell: elevation relative to the mean, variance, slope (q, 2)."""
        rows, columns = task.grid.shape
        std = None if variance is None else np.sqrt(np.maximum(variance, 0)).reshape(rows, columns)
        return cls(
            (elevation + task.mean).reshape(rows, columns),
            std,
            None if slope is None else slope.reshape(rows, columns, 2),
        )

    @property
    def fields(self) -> str:
        """What it holds, for a table."""
        names = {"elevation": True, "std": self.std is not None, "slopes": self.slope is not None}
        return ", ".join(name for name, there in names.items() if there)

    def save(self, path: Path) -> None:
        """Write the fields that are there."""
        there = {name: field for name, field in vars(self).items() if field is not None}
        np.savez(path, **there)

    @classmethod
    def load(cls, path: Path) -> "Answer":
        """Read what `save` wrote."""
        with np.load(path) as stored:
            return cls(**{name: stored[name] for name in stored.files})


@dataclass(frozen=True)
class Errors:
    """Of an answer to the oracle's; None where the method has no such field."""

    elevation: float  # rms, in units of the noise
    slope: float | None  # rms, relative to the slopes' rms
    std_trusted: float | None  # largest relative one of a trusted cell
    std_anywhere: float | None  # largest relative one of any cell

    @classmethod
    def between(cls, answer: Answer, oracle: Answer, signal_std: float) -> "Errors":
        """Compare an answer with one that has all fields."""
        assert oracle.std is not None
        assert oracle.slope is not None
        slope = std = None
        if answer.slope is not None:
            slope = rms(answer.slope - oracle.slope) / rms(oracle.slope)
        if answer.std is not None:
            std = np.abs(answer.std / oracle.std - 1)
        trusted = oracle.std <= TRUSTED * signal_std
        return cls(
            rms(answer.elevation - oracle.elevation) / NOISE,
            slope,
            None if std is None else float(std[trusted].max(initial=0.0)),
            None if std is None else float(std.max()),
        )

    def all_below(self, other: "Errors") -> bool:
        """Say whether each is smaller, of the fields that both have."""
        pairs = zip(vars(self).values(), vars(other).values(), strict=True)
        return all(own < its for own, its in pairs if own is not None and its is not None)

    def as_dict(self) -> dict[str, float | None]:
        """For JSON."""
        return asdict(self)


def rms(values: Array) -> float:
    """Root of the mean square."""
    return float(np.sqrt(np.mean(values**2)))
