"""Where two registered maps agree, and where they do not: the evidence, place by place."""

import numpy as np
from jaxtyping import Float32

from gpgrad_core.arrays import NDArray
from gpgrad_core.registration.evidence import map_evidence
from gpgrad_core.registration.relief import make_relief
from gpgrad_core.se2 import SE2
from gpgrad_core.types import MAX_STD_RATIO, GradientMap, Grid


def map_agreement(
    query: GradientMap,
    database: GradientMap,
    T_database_query: SE2,
    max_std_ratio: float = MAX_STD_RATIO,
) -> tuple[Grid, Float32[NDArray[np.float32], "rows columns"]]:
    """Compute the evidence for one terrain at each place of the overlap.

    Args:
        query: The map that is placed.
        database: The map on which it is placed.
        T_database_query: The motion.
        max_std_ratio: Threshold of the variance mask; only trusted cells are compared.

    Returns:
        The cells around the overlap in the database's frame, as coarse as the comparison, and for
        each the log-likelihood ratio of one terrain against two. It is above 0 where the heights
        agree by more than chance, below 0 where they differ by more than the uncertainty of both
        maps allows, and NaN where there is nothing to compare.
    """
    reliefs = make_relief(query, max_std_ratio), make_relief(database, max_std_ratio)
    return map_evidence(*reliefs, T_database_query)
