"""All pairs in the cells of a matrix: a pair in each cell, or a block of pairs where many are.

A page draws a few thousand cells well, and no more. So the submaps are gathered in groups of equal
size, and a cell stands for all pairs of two groups: by its highest score and its worst outcome.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from app.viewer.all_pairs.judging import JudgedPairs
from app.viewer.decisions import ACCEPTED, MISSED, NO_OVERLAP, REFUSED, RIGHT, WRONG_MOTION
from gpgrad_core.arrays import Array
from gpgrad_core.types import LoopClosure

MOST_GROUPS = 60
"""Rows of a matrix."""
WORST_FIRST = (NO_OVERLAP, WRONG_MOTION, MISSED, RIGHT, ACCEPTED, REFUSED)


@dataclass(frozen=True)
class Cell:
    """The pairs of one cell.

    Attributes:
        query: Id of the query of the pair with the highest score.
        database: Id of its database submap.
        score: Its score.
        outcome: The worst outcome of all pairs of the cell.
        num_pairs: Number of them.
    """

    query: str
    database: str
    score: float
    outcome: str
    num_pairs: int


@dataclass(frozen=True, eq=False)
class PairCells:
    """Cells by rows (queries) and columns (database submaps).

    Attributes:
        rows: Ids of the submaps in each row, in the dataset's order.
        columns: Ids of the submaps in each column.
        cells: By (row, column); where no pair was compared there is none.
        overlaps: Highest true overlap (rows, columns) of the pairs whose query is in the column and
            whose database submap is in the row, mirrored to `cells`; NaN where it is not known.
    """

    rows: tuple[tuple[str, ...], ...]
    columns: tuple[tuple[str, ...], ...]
    cells: Mapping[tuple[int, int], Cell]
    overlaps: Float[Array, "rows columns"]

    @property
    def has_blocks(self) -> bool:
        """Whether a cell stands for several pairs."""
        return any(len(group) > 1 for group in (*self.rows, *self.columns))

    def place(self, query: str, database: str) -> tuple[int, int] | None:
        """Find the cell of a pair (row, column); None if it is not in this matrix."""
        row = next((k for k, group in enumerate(self.rows) if query in group), None)
        column = next((k for k, group in enumerate(self.columns) if database in group), None)
        return None if row is None or column is None else (row, column)


def gather_all(judged: JudgedPairs) -> PairCells:
    """Put all pairs of a dataset into at most `MOST_GROUPS` rows and columns."""
    ids = [submap.id for submap in judged.compared.dataset.submaps]
    size = max(1, -(-len(ids) // MOST_GROUPS))
    groups = tuple(tuple(ids[k : k + size]) for k in range(0, len(ids), size))
    return gather(judged, groups, groups)


def gather_block(judged: JudgedPairs, whole: PairCells, pair: tuple[str, str]) -> PairCells | None:
    """Show the pairs of one block one by one.

    Args:
        judged: All pairs with their verdicts.
        whole: What `gather_all` made of them.
        pair: (query, database) of a pair in the block, the later submap first.

    Returns:
        The pairs of the block; None where every cell of the whole is a single pair, or where the
        pair is of another dataset.
    """
    place = whole.place(*pair)
    if place is None or not whole.has_blocks:
        return None
    rows, columns = whole.rows[place[0]], whole.columns[place[1]]
    return gather(judged, tuple((name,) for name in rows), tuple((name,) for name in columns))


def gather(
    judged: JudgedPairs, rows: Sequence[tuple[str, ...]], columns: Sequence[tuple[str, ...]]
) -> PairCells:
    """Put the pairs of some submaps into cells.

    Args:
        judged: All pairs with their verdicts.
        rows: Ids of the queries of each row.
        columns: Ids of the database submaps of each column.
    """
    row_of = {name: k for k, group in enumerate(rows) for name in group}
    column_of = {name: k for k, group in enumerate(columns) for name in group}
    worst = {outcome: rank for rank, outcome in enumerate(WORST_FIRST)}
    best: dict[tuple[int, int], LoopClosure] = {}
    outcomes: dict[tuple[int, int], str] = {}
    counts: dict[tuple[int, int], int] = {}
    for closure, outcome in zip(judged.closures, judged.outcomes, strict=True):
        row, column = row_of.get(closure.query_id), column_of.get(closure.database_id)
        if row is None or column is None:
            continue
        at = row, column
        counts[at] = counts.get(at, 0) + 1
        if at not in best or closure.registration.score > best[at].registration.score:
            best[at] = closure
        if at not in outcomes or worst[outcome] < worst[outcomes[at]]:
            outcomes[at] = outcome
    cells = {
        at: Cell(one.query_id, one.database_id, one.registration.score, outcomes[at], counts[at])
        for at, one in best.items()
    }
    overlaps = _overlaps(judged, row_of, column_of, (len(rows), len(columns)))
    return PairCells(tuple(rows), tuple(columns), cells, overlaps)


def _overlaps(
    judged: JudgedPairs,
    row_of: Mapping[str, int],
    column_of: Mapping[str, int],
    shape: tuple[int, int],
) -> Float[Array, "rows columns"]:
    overlaps = np.full(shape, np.nan)
    truth = judged.compared.truth
    if truth is None or judged.check is None:
        return overlaps
    rows = np.array([row_of.get(name, -1) for name in truth.ids])[truth.database]
    columns = np.array([column_of.get(name, -1) for name in truth.ids])[truth.query]
    # On the diagonal, the pairs within a group are shown by their scores.
    known = (rows >= 0) & (columns >= 0) & (rows != columns)
    measured = judged.check.rule.measured(truth)
    np.fmax.at(overlaps, (rows[known], columns[known]), measured[known])
    return overlaps
