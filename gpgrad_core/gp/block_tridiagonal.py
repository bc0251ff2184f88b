"""Symmetric positive definite block-tridiagonal matrices: factors, solutions, inverse blocks."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from gpgrad_core.arrays import Floats

LARGEST_LEAF = 48
"""Largest number of rows that LAPACK inverts directly; the best of those measured, 24 to 128."""


class NotPositiveDefiniteError(ArithmeticError):
    """A block cannot be factorised: with rounding errors the matrix is not positive definite."""


@dataclass(frozen=True, eq=False)
class Factor:
    """Block Gaussian elimination from the first block to the last.

    With diagonal blocks D_i and blocks E_i below them, the pivots are
    ``P_0 = D_0`` and ``P_(i+1) = D_(i+1) - E_i P_i⁻¹ E_iᵀ``.
    """

    inverses: list[Float[Floats, "_ _"]]  # the inverse pivots P_i⁻¹
    gains: list[Float[Floats, "_ _"]]  # the products E_i P_i⁻¹

    def solve(self, right: list[Float[Floats, "_"]]) -> list[Float[Floats, "_"]]:
        """Solve for one right-hand side, divided into blocks; the solution is in blocks too."""
        forward: list[Floats] = [right[0]]
        for gain, block in zip(self.gains, right[1:], strict=True):
            forward.append(block - gain @ forward[-1])
        solution: list[Floats] = [self.inverses[-1] @ forward[-1]]  # last block first
        for i in reversed(range(len(self.gains))):
            solution.append(self.inverses[i] @ forward[i] - self.gains[i].T @ solution[-1])
        return solution[::-1]

    def inverse_blocks(
        self,
    ) -> Iterator[tuple[int, Float[Floats, "_ _"], Float[Floats, "_ _"] | None]]:
        """Yield (i, diagonal block i of the inverse, block (i + 1, i) or None), last first.

        Takahashi's recursion computes no other block of the inverse.
        """
        last = len(self.inverses) - 1
        diagonal = self.inverses[last]
        yield last, diagonal, None
        for i in reversed(range(last)):
            below = diagonal @ self.gains[i]
            np.negative(below, out=below)
            diagonal = self.inverses[i] - self.gains[i].T @ below
            yield i, diagonal, below


def invert_pivot(pivot: Float[Floats, "m m"]) -> Float[Floats, "m m"]:
    """Invert a symmetric positive definite block by halves, mostly with matrix products.

    At these sizes LAPACK's own inversion runs at a tenth of the speed of a matrix product. The part
    of the pivot below its diagonal is not read.
    """
    size = len(pivot)
    if size <= LARGEST_LEAF:
        return _invert_leaf(pivot)
    half = size // 2
    first = invert_pivot(pivot[:half, :half])
    coupling = pivot[:half, half:]
    gain = coupling.T @ first
    second = invert_pivot(pivot[half:, half:] - gain @ coupling)
    inverse = np.empty_like(pivot)
    below = second @ gain
    inverse[half:, half:] = second
    inverse[:half, :half] = first
    inverse[:half, :half] += gain.T @ below
    np.negative(below, out=below)
    inverse[half:, :half] = below
    inverse[:half, half:] = below.T
    return inverse


def _invert_leaf(pivot: Float[Floats, "m m"]) -> Float[Floats, "m m"]:
    from scipy.linalg.lapack import dpotrf, dtrtri, spotrf, strtri  # noqa: PLC0415 - loads slowly

    single = pivot.dtype == np.float32
    factorise, invert = (spotrf, strtri) if single else (dpotrf, dtrtri)
    # LAPACK needs an F-ordered array, which is the transpose of a C-ordered one.
    factor, failed = factorise(pivot.T, lower=1)
    if failed:
        raise NotPositiveDefiniteError(f"pivot {failed} is not positive")
    inverse, _ = invert(factor, lower=1, overwrite_c=1)
    return inverse.T @ inverse
