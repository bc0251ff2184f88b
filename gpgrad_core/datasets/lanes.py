"""A drive without an end: along crossing lanes, with returns to places of every age."""

import numpy as np
from jaxtyping import Float
from numpy.random import Generator
from scipy import ndimage

from gpgrad_core.arrays import Array

LEAST_LANE = 40.0
"""Smallest distance between two parallel lanes [m]."""
RANGES_APART = 4.0
"""Smallest distance between two parallel lanes, in ranges of the sensor: submaps on different lanes
share no ground, except at crossings."""
NEW_GROUND = 0.7
"""There are so many lanes between crossings, as a share of those that are driven."""
RETURN = 0.3
"""Probability that the rover takes a lane that it knows, at a crossing that has one."""
TURN = 4.0
"""Width of the Gaussian that rounds the corners [m]."""
ROUNDED = 1.15
"""Lanes that are planned, as a share of those that are needed: the corners are cut."""
WEAVE = 83.0
"""Distance from one swing to the same side to the next [m]. It fits into no number of lanes, so the
rover comes back at another place of the lane's width."""
AHEAD = ((1, 0), (0, 1), (-1, 0), (0, -1))
"""The four directions, each a quarter turn left of the one before."""


def drive_lanes(
    length: float, step: float, sensor_range: float, swing: float, rng: Generator
) -> Float[Array, "n 2"]:
    """Plan a drive: at each crossing straight on, left or right, never back.

    The lattice of lanes grows with the drive, so that 3 of 10 lanes or more are driven again, in
    either direction, after any time.

    Args:
        length: Length of the drive [m].
        step: Approximate distance between its points [m].
        sensor_range: How far the sensor sees [m].
        swing: How far the rover swings to either side of a lane [m].
        rng: Generator of the turns.

    Returns:
        Positions (n, 2) [m]; the drive is a little longer than asked for.
    """
    lane = max(LEAST_LANE, RANGES_APART * sensor_range)
    count = int(np.ceil(ROUNDED * length / lane)) + 2
    nodes = lane * _walk(count, rng)
    per_lane = round(lane / step)
    along = np.arange(count * per_lane + 1) / per_lane
    corners = np.arange(count + 1)
    xy = np.column_stack([np.interp(along, corners, nodes[:, axis]) for axis in range(2)])
    xy = ndimage.gaussian_filter1d(xy, TURN / step, axis=0, mode="nearest")
    ahead = np.gradient(xy, axis=0)
    ahead /= np.hypot(ahead[:, 0], ahead[:, 1])[:, None]
    offset = swing * np.sin(2.0 * np.pi * lane * along / WEAVE)
    return xy + offset[:, None] * np.column_stack([-ahead[:, 1], ahead[:, 0]])


def _walk(count: int, rng: Generator) -> Float[Array, "m 2"]:
    """Walk over so many edges of a square lattice, and list the crossings."""
    side = int(np.ceil(0.5 * (1.0 + np.sqrt(1.0 + 2.0 * NEW_GROUND * count)))) + 1
    at, heading = (0, 0), 0
    known: set[frozenset[tuple[int, int]]] = set()
    places = [at]
    for _ in range(count):
        choices: list[tuple[int, tuple[int, int]]] = []
        for turn in (-1, 0, 1):
            new = (heading + turn) % 4
            there = at[0] + AHEAD[new][0], at[1] + AHEAD[new][1]
            if all(0 <= k < side for k in there):
                choices.append((new, there))
        before = [choice for choice in choices if frozenset((at, choice[1])) in known]
        others = [choice for choice in choices if choice not in before]
        preferred = before if before and (not others or rng.random() < RETURN) else others
        heading, there = preferred[int(rng.integers(len(preferred)))]
        known.add(frozenset((at, there)))
        at = there
        places.append(at)
    return np.array(places, dtype=np.float64)
