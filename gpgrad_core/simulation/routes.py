"""Where a simulated rover drives: out and back, or along crossing lanes without an end."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy.random import Generator
from scipy import ndimage

from gpgrad_core.arrays import Array
from gpgrad_core.errors import InputError
from gpgrad_core.params import bounds_of
from gpgrad_core.se2 import SE2
from gpgrad_core.simulation.params import ROUTE_STREAM, SimulationParams, stream

STEP = 0.05
"""Distance between the points of a track [m]."""
LEAST_LANE = 40.0
"""Smallest distance between two parallel lanes [m]."""
RANGES_APART = 4.0
"""Smallest distance between two parallel lanes, in ranges of the sensor: submaps on different lanes
share no ground, except at crossings."""
NEW_GROUND = 0.7
"""There are so many lanes between crossings, as a share of those that are driven."""
RETURN = 0.3
"""Probability that the rover takes a lane that it knows, at a crossing that has one."""
LEAST_ACROSS = 20.0
"""Smallest length of a lane across rows [m]."""
CORNER = 1.0
"""Width of the Gaussian that rounds the corners of the serpentine route [m]."""
TURN = 4.0
"""Width of the Gaussian that rounds the corners of crossing lanes [m]."""
ROUNDED = 1.15
"""Lanes that are planned, as a share of those that are needed: the corners are cut."""
WEAVE = 83.0
"""Distance from one swing to the same side to the next [m]. It fits into no number of lanes, so the
rover comes back at another place of the lane's width."""
AHEAD = ((1, 0), (0, 1), (-1, 0), (0, -1))
"""The four directions, each a quarter turn left of the one before."""


@dataclass(frozen=True, eq=False)
class Track:
    """A drive out and back, as points with the distance `STEP`."""

    xy: Float[Array, "n 2"]  # positions (n, 2) [m]
    yaw: Float[Array, "n"]  # heading of the rover at each position (n,) [rad]

    @property
    def length(self) -> float:
        return STEP * (len(self.xy) - 1)

    def between(self, distance: float) -> SE2:
        """Interpolate the rover's pose after a distance driven [m]."""
        after = STEP * np.arange(len(self.xy))
        x, y = (float(np.interp(distance, after, self.xy[:, axis])) for axis in range(2))
        return SE2(x, y, float(np.interp(distance, after, np.unwrap(self.yaw))))

    def at(self, distance: float) -> SE2:
        """Find the point of the track nearest to a distance driven [m]; it stays at the end."""
        k = min(round(distance / STEP), len(self.xy) - 1)
        return SE2(float(self.xy[k, 0]), float(self.xy[k, 1]), float(self.yaw[k]))


def plan_track(params: SimulationParams) -> Track:
    """Plan the drive: out along the route, then back beside it, crossing it several times."""
    if params.route == "roaming":
        return _roam(params)
    num_out = (params.num_submaps + 1) // 2
    length = num_out * params.spacing
    distance = np.arange(0.0, length + 0.5 * STEP, STEP)
    out = _way_out(params, distance)
    swing = params.lateral_offset * np.sin(2.0 * np.pi * distance / max(17.0, length / 2.0))
    along = np.gradient(out, axis=0)
    normal = np.column_stack([-along[:, 1], along[:, 0]])
    normal /= np.hypot(along[:, 0], along[:, 1])[:, None]
    back = _resample(out[::-1] + swing[:, None] * normal[::-1])
    margin = params.max_range + 0.5
    low, high = np.vstack([out, back]).min(axis=0), np.vstack([out, back]).max(axis=0)
    needed = float(np.max(high - low)) + 2.0 * margin
    if needed > params.extent:
        drive = (
            f"{params.num_submaps} submaps {params.spacing:g} m apart on the route {params.route!r}"
        )
        most = bounds_of(SimulationParams)["extent"].high
        if needed > most:
            raise InputError(
                f"{drive} need an extent of {np.ceil(needed):g} m, more than the {most:g} m "
                "allowed; lower num_submaps, spacing or max_range, or take the route 'roaming'"
            )
        raise InputError(
            f"extent must be {np.ceil(needed):g} m or more for {drive}, got {params.extent:g} m"
        )
    shift = 0.5 * params.extent - 0.5 * (low + high)
    xy = np.vstack([out[:-1], back]) + shift
    yaw = np.concatenate([_headings(out)[:-1], _headings(back)])
    return Track(xy, yaw)


def _roam(params: SimulationParams) -> Track:
    length, rng = params.num_submaps * params.spacing, stream(params.seed, ROUTE_STREAM)
    xy = _resample(drive_lanes(length, STEP, params.max_range, params.lateral_offset, rng))
    return Track(xy, _headings(xy))


def _way_out(params: SimulationParams, distance: Float[Array, "n"]) -> Float[Array, "n 2"]:
    """Compute the points of the way out, with the distance `STEP`, from its headings."""
    route, share = params.route, distance / distance[-1]
    if route == "serpentine":
        return _serpentine(params, distance[-1])[: len(distance)]
    if route == "winding":
        # It is oblique to the grid of the ground and to the bounding boxes, to favour neither.
        yaw = 0.6 + 0.5 * np.sin(2.0 * np.pi * distance / 28.0)
    elif route == "loop":
        yaw = 2.0 * np.pi * share + 0.35 * np.sin(6.0 * np.pi * share)
    else:
        # One ring to the left, then one to the right.
        yaw = 2.0 * np.pi * np.minimum(2.0 * share, 2.0 - 2.0 * share)
    steps = STEP * np.column_stack([np.cos(yaw), np.sin(yaw)])
    return np.vstack([[0.0, 0.0], np.cumsum(steps[:-1], axis=0)])


def _serpentine(params: SimulationParams, length: float) -> Float[Array, "n 2"]:
    """Plan lanes across rows and along them, by turns; lanes side by side see no common ground."""
    apart = 2.0 * params.max_range + 2.0
    across = params.row_spacing * np.ceil(max(apart, LEAST_ACROSS) / params.row_spacing)
    # The corners, which are cut, make the drive shorter than its legs: there are more than enough.
    legs = np.arange(2 * int(np.ceil(length / (across + apart))) + 2)
    yaw = params.row_heading + np.array([0.0, 0.5, 1.0, 0.5])[legs % 4] * np.pi
    steps = np.where(legs % 2, apart, across)[:, None] * np.column_stack([np.cos(yaw), np.sin(yaw)])
    corners = np.vstack([[0.0, 0.0], np.cumsum(steps, axis=0)])
    return _resample(
        ndimage.gaussian_filter1d(_resample(corners), CORNER / STEP, 0, mode="nearest")
    )


def _resample(xy: Float[Array, "n 2"]) -> Float[Array, "m 2"]:
    """Resample a line to points with the distance `STEP`."""
    steps = np.diff(xy, axis=0)
    travelled = np.concatenate([[0.0], np.cumsum(np.hypot(steps[:, 0], steps[:, 1]))])
    even = np.arange(0.0, travelled[-1], STEP)
    return np.column_stack([np.interp(even, travelled, xy[:, axis]) for axis in range(2)])


def _headings(xy: Float[Array, "n 2"]) -> Float[Array, "n"]:
    along = np.gradient(xy, axis=0)
    return np.arctan2(along[:, 1], along[:, 0])


def drive_lanes(
    length: float, step: float, sensor_range: float, swing: float, rng: Generator
) -> Float[Array, "n 2"]:
    """Plan a drive of a length [m]: at each crossing straight on, left or right, never back."""
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
    driven: set[frozenset[tuple[int, int]]] = set()
    places = [at]
    for _ in range(count):
        choices: list[tuple[int, tuple[int, int]]] = []
        for turn in (-1, 0, 1):
            new = (heading + turn) % 4
            there = at[0] + AHEAD[new][0], at[1] + AHEAD[new][1]
            if all(0 <= k < side for k in there):
                choices.append((new, there))
        before = [choice for choice in choices if frozenset((at, choice[1])) in driven]
        others = [choice for choice in choices if choice not in before]
        preferred = before if before and (not others or rng.random() < RETURN) else others
        heading, there = preferred[int(rng.integers(len(preferred)))]
        driven.add(frozenset((at, there)))
        at = there
        places.append(at)
    return np.array(places, dtype=np.float64)
