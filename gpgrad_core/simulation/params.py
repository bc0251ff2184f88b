"""The parameters of a simulated dataset."""

from dataclasses import dataclass
from typing import Annotated, Literal

from numpy.random import PCG64, Generator, SeedSequence
from typing_extensions import Doc

from gpgrad_core.params import SEEDS, Bounds, check_bounds


@dataclass(frozen=True)
class SimulationParams:
    """Terrain, route, sensor and odometry of a simulated rover.

    The defaults imitate submaps of a small rover with a panned stereo camera: boxes of about
    11 m x 13 m, 30,000 points, range noise of 4 cm at 3 m and 13 cm at 6 m. The other sensors
    are a spinning LiDAR, which sees all around, and an airborne scanner that looks straight down
    from above the route, so that nothing is hidden and the density is the same everywhere.
    """

    seed: Annotated[
        int,
        SEEDS,
        Doc("Seed of all random choices. The same seed gives the same dataset, bit for bit."),
    ] = 0
    num_submaps: Annotated[
        int,
        Bounds(1, 100_000, 1, "submaps"),
        Doc(
            "Number of submaps. The rover makes half of them on the way back. The route roaming "
            "has no way back."
        ),
    ] = 24
    route: Annotated[
        Literal["winding", "loop", "figure_eight", "serpentine", "roaming"],
        Doc(
            "Shape of the way out. The way back follows it in the opposite direction. The route "
            "serpentine goes across the rows of repeated ground and along them by turns, a whole "
            "number of rows each time. On the route "
            "roaming the rover drives along crossing lanes, as far as it likes, and comes back to "
            "places that it left a short or a long time ago."
        ),
    ] = "loop"
    spacing: Annotated[
        float,
        Bounds(1.0, 20.0, 0.5, "m"),
        Doc("Distance driven from the start of one submap to the start of the next."),
    ] = 5.0
    lateral_offset: Annotated[
        float,
        Bounds(0.0, 5.0, 0.1, "m"),
        Doc(
            "How far the way back swings to either side of the way out, which it crosses; on the "
            "route roaming, how far every way swings."
        ),
    ] = 1.0
    extent: Annotated[
        float,
        Bounds(10.0, 240.0, 1.0, "m"),
        Doc(
            "Side of the square of terrain. The route and all that the sensor sees must fit into "
            "it. The route roaming makes the ground where the rover drives."
        ),
    ] = 44.0
    ground: Annotated[
        Literal["varied", "ripples", "furrows", "dunes", "spurs"],
        Doc(
            "Kind of ground. On all but varied there are rows that look alike: wind ripples, the "
            "furrows of a field, parallel dunes, or the spurs of a hillside. gpgrad simulate then "
            "sets what no flag says to what suits the kind: the rows, a weak relief without "
            "craters or rocks, and the route serpentine."
        ),
    ] = "varied"
    row_spacing: Annotated[
        float,
        Bounds(0.2, 40.0, 0.1, "m"),
        Doc("Distance from row to row, on ground with rows."),
    ] = 1.0
    row_height: Annotated[
        float,
        Bounds(0.0, 5.0, 0.01, "m"),
        Doc("Height of the rows above the bottoms between them."),
    ] = 0.1
    row_heading: Annotated[
        float,
        Bounds(-3.15, 3.15, 0.05, "rad"),
        Doc("Direction across the rows, from x towards y."),
    ] = 0.4
    row_variety: Annotated[
        float,
        Bounds(0.0, 1.0, 0.05),
        Doc(
            "How much the rows differ. 0 makes all alike; 0.2 bends them a little and makes some "
            "higher than others; from 0.4 they fork and end."
        ),
    ] = 0.2
    relief: Annotated[
        float,
        Bounds(0.0, 5.0, 0.05, "m"),
        Doc("Standard deviation of the fractal ground's height."),
    ] = 0.35
    hill_height: Annotated[
        float,
        Bounds(0.0, 20.0, 0.1, "m"),
        Doc(
            "Standard deviation of the height of the smooth hills under the fractal ground. 0 "
            "makes none."
        ),
    ] = 0.0
    hill_size: Annotated[
        float,
        Bounds(4.0, 200.0, 1.0, "m"),
        Doc(
            "Distance from hill to hill. The hills' slopes are about 5 times their height divided "
            "by this."
        ),
    ] = 16.0
    roughness: Annotated[
        float,
        Bounds(0.0, 1.0, 0.05),
        Doc("Share of small bumps in the fractal ground. 0 is rolling, 1 is jagged."),
    ] = 0.3
    crater_density: Annotated[
        float,
        Bounds(0.0, 0.2, 0.005, "1/m²"),
        Doc("Number of craters per square metre. They are 1 m to 8 m across."),
    ] = 0.04
    dune_height: Annotated[
        float,
        Bounds(0.0, 0.5, 0.01, "m"),
        Doc("Height of the wind ripples. They lie in patches."),
    ] = 0.1
    rock_density: Annotated[
        float,
        Bounds(0.0, 5.0, 0.1, "1/m²"),
        Doc(
            "Number of rocks per square metre. They are 10 cm to 1.2 m across, and most are small."
        ),
    ] = 1.5
    sensor: Annotated[
        Literal["stereo", "lidar", "airborne"],
        Doc(
            "Sensor: a panned stereo camera or a LiDAR of the rover, which sees all around in "
            "rings, or an airborne scanner, which looks straight down."
        ),
    ] = "stereo"
    scan_density: Annotated[
        float,
        Bounds(0.5, 1000.0, 0.5, "1/m²"),
        Doc("Points of the airborne scanner per square metre, before drop-outs."),
    ] = 50.0
    camera_height: Annotated[
        float,
        Bounds(0.2, 3.0, 0.1, "m"),
        Doc("Height of the sensor above the ground under the rover."),
    ] = 1.2
    field_of_view: Annotated[
        float,
        Bounds(0.3, 3.1, 0.1, "rad"),
        Doc("Angle that the panned camera sees at one stop. A LiDAR sees all around."),
    ] = 2.1
    lidar_rings: Annotated[
        int,
        Bounds(2, 128, 1, "rings"),
        Doc("Number of the LiDAR's rays above one another."),
    ] = 64
    max_range: Annotated[
        float,
        Bounds(2.0, 60.0, 0.5, "m"),
        Doc("The sensor finds nothing beyond this distance, seen from above if it is airborne."),
    ] = 7.0
    noise_constant: Annotated[
        float,
        Bounds(0.0, 0.5, 0.001, "m"),
        Doc("Standard deviation of a range measured next to the sensor, or of an airborne height."),
    ] = 0.005
    noise_quadratic: Annotated[
        float,
        Bounds(0.0, 0.1, 0.0005, "1/m"),
        Doc(
            "How much the standard deviation of a range grows with its square, in stereo. That of "
            "the other sensors does not grow."
        ),
    ] = 0.0035
    noise_common: Annotated[
        float,
        Bounds(0.0, 1.0, 0.05),
        Doc(
            "Share of the variance of a camera's or a LiDAR's ranges that neighbouring rays have "
            "in common, as stereo matching makes it over patches."
        ),
    ] = 0.0
    dropout_rate: Annotated[
        float,
        Bounds(0.0, 0.9, 0.05),
        Doc("Share of the rays that find nothing, in patches and one by one."),
    ] = 0.2
    submap_drift: Annotated[
        float,
        Bounds(0.0, 0.1, 0.001, "m/√m"),
        Doc(
            "Random walk of the position within a submap, along each axis. Yaw drifts by the same "
            "number in radians."
        ),
    ] = 0.004
    odometry_drift: Annotated[
        float,
        Bounds(0.0, 0.3, 0.005),
        Doc(
            "Standard deviation of odometry's error from submap to submap, as a share of the "
            "distance."
        ),
    ] = 0.02
    heading_drift: Annotated[
        float,
        Bounds(0.0, 0.2, 0.001, "rad/√m"),
        Doc("Random walk of odometry's heading."),
    ] = 0.012
    voxel_size: Annotated[
        float,
        Bounds(0.01, 0.5, 0.01, "m"),
        Doc("All points within one cube of this side are replaced by their mean."),
    ] = 0.04
    max_points: Annotated[
        int,
        Bounds(100, 1_000_000, 1000, "points"),
        Doc("A submap with more points than this is thinned to this many at random."),
    ] = 30_000

    @property
    def range_noise(self) -> tuple[float, float]:
        """Standard deviation of a range r [m]: the first [m] + the second [1/m] times r²."""
        return self.noise_constant, self.noise_quadratic if self.sensor == "stereo" else 0.0

    def __post_init__(self) -> None:
        check_bounds(self)


TERRAIN_STREAM, ODOMETRY_STREAM, SUBMAP_STREAM, SCAN_STREAM, ROUTE_STREAM, ROCK_STREAM = range(6)
"""What random numbers are drawn for, after the seed: each has its own, so that a change of one
leaves the others as they were. With other numbers here, a seed would make another world."""


def stream(*path: int) -> Generator:
    """Make an independent random generator of a path of numbers that begins with the seed."""
    return Generator(PCG64(SeedSequence(path)))


def stream_at(seed: int, number: int, i: int, j: int) -> Generator:
    """Make the random generator of what has a number, at a square of a lattice."""
    return stream(seed, number, *(2 * k if k >= 0 else -2 * k - 1 for k in (i, j)))
