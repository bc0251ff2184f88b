"""What stands on the ground, and what no ground explains, is left out; bare ground stays."""

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from gpgrad_core.arrays import Array
from gpgrad_core.errors import InputError
from gpgrad_core.ground import find_non_ground
from gpgrad_core.io.folder import load_dataset, write_dataset
from gpgrad_core.outliers import find_outliers
from gpgrad_core.types import Dataset, Submap
from tests.support.ground import cloud
from tests.support.laws import examples

GROUND = cloud(3, 6000, (10.0, 10.0))


def bushes(seed: int, count: int = 6) -> Array:
    """Make balls of leaves on the ground, and a wall."""
    rng = np.random.default_rng(seed)
    places = np.column_stack([rng.uniform(1, 9, (count, 2)), np.full(count, 1.2)])
    leaves = [place + rng.uniform(-0.7, 0.7, (400, 3)) for place in places]
    wall = np.column_stack([rng.uniform(2, 5, 500), np.full(500, 8.0), rng.uniform(0, 2.5, 500)])
    return np.vstack([*leaves, wall])


@given(seed=st.integers(0, 1000))
def test_bushes_and_walls_are_found_and_the_ground_stays(seed: int) -> None:
    standing = find_non_ground(np.vstack([GROUND, bushes(seed)]))
    assert standing[: len(GROUND)].mean() < 0.05
    assert standing[len(GROUND) :].mean() > 0.95


@examples(30)
@given(
    seed=st.integers(0, 1000),
    num=st.sampled_from([500, 5000, 20_000]),
    slope=st.floats(-1.2, 1.2),
    noise=st.sampled_from([0.0, 0.02, 0.1, 0.3]),
)
def test_bare_ground_stays_whole(seed: int, num: int, slope: float, noise: float) -> None:
    points = cloud(seed, num, (8.0, 8.0), noise=noise, holes=3)
    points[:, 2] += slope * points[:, 0]
    assert not find_non_ground(points).any()


def test_boulders_and_a_cliff_are_terrain() -> None:
    points = cloud(5, 20_000, (10.0, 10.0))
    rng = np.random.default_rng(1)
    for x, y in rng.uniform(1, 9, (12, 2)):
        away = np.hypot(points[:, 0] - x, points[:, 1] - y)
        points[:, 2] += np.where(away < 0.4, 0.8, 0.0)
    points[:, 2] += np.where(points[:, 0] > 6.0, 2.0, 0.0)
    assert not find_non_ground(points).any()


def test_the_choice_decides() -> None:
    points = np.vstack([GROUND, bushes(0, 1)[:150]])  # too few to be left out by themselves
    for choice in ("automatic", "all"):
        assert not find_non_ground(points, choice).any()
    assert find_non_ground(points, "filtered")[6000:].mean() > 0.95
    for num in (0, 3, 299):
        assert not find_non_ground(np.random.default_rng(0).uniform(size=(num, 3))).any()


def test_a_cloud_without_ground_or_extent_is_left_as_it_is() -> None:
    rng = np.random.default_rng(0)
    crown = rng.uniform(size=(3000, 3))
    line = np.column_stack([rng.uniform(size=(3000, 1)), np.zeros((3000, 1)), crown[:, 2]])
    for points in (crown, crown * (1e-9, 1e-9, 1), crown * (1e6, 1, 1), line, crown * 0.0):
        for choice in ("automatic", "filtered"):
            standing = find_non_ground(points, choice)
            assert standing.mean() <= 0.9


def test_a_submap_counts_and_keeps_aside_what_stands() -> None:
    points = np.vstack([GROUND, bushes(2), [[5.0, 5.0, 1e4]]])
    submap = Submap.from_points(points, ranges=np.arange(float(len(points))))
    assert submap.num_wild == 1
    assert submap.num_standing > 2500
    assert len(submap.left_out) == submap.num_wild + submap.num_standing
    assert submap.num_points + len(submap.left_out) == len(points)
    np.testing.assert_array_equal(points[submap.ranges.astype(int)], submap.points)


def test_a_dataset_file_decides_and_notes_tell(tmp_path_factory: pytest.TempPathFactory) -> None:
    folder = tmp_path_factory.mktemp("ground") / "set"
    points = np.vstack([GROUND, bushes(2)])
    whole = Submap.from_points(points, "000", ground="all")
    write_dataset(Dataset("set", (whole,), ground="all"), folder)
    kept = load_dataset(folder)
    assert (kept.ground, kept.submaps[0].num_points, kept.notes) == ("all", len(points), ())
    (folder / "dataset.toml").write_text('name = "set"\n')
    filtered = load_dataset(folder)
    left_out = f"{filtered.submaps[0].num_standing:,} of {len(points):,} points were left out"
    assert f"{left_out}: they stand on the gr" in str(filtered.notes)
    (folder / "dataset.toml").write_text('ground = "some"\n')
    with pytest.raises(InputError, match=r"dataset\.toml.*ground"):
        load_dataset(folder)


FIELD = cloud(3, 3000, (8.0, 8.0))
SPARSE = cloud(5, 300, (8.0, 8.0))


@given(
    x=st.floats(0, 8),
    y=st.floats(0, 8),
    power=st.floats(0.7, 9),
    below=st.booleans(),
    sparse=st.booleans(),
)
def test_a_point_far_above_or_below_is_wild(
    x: float, y: float, power: float, below: bool, sparse: bool
) -> None:
    height = 10**power * (-1 if below else 1)
    points = SPARSE if sparse else FIELD
    wild = find_outliers(np.vstack([points, [[x, y, height]]]))
    assert wild[-1]
    assert not wild[:-1].any()


@pytest.mark.parametrize("distance", [12.0, 900.0, 1e6, 9e8])
@pytest.mark.parametrize("points", [FIELD, SPARSE])
def test_a_point_far_beside_is_wild(points: Array, distance: float) -> None:
    beside = [[4.0 - distance, 4.0, 0.0], [4.0, 8.0 + distance, 0.0]]
    wild = find_outliers(np.vstack([beside, points]))
    assert wild[:2].all()
    assert not wild[2:].any()


def test_one_in_a_hundred_is_found_among_the_others() -> None:
    rng = np.random.default_rng(0)
    places, powers = rng.uniform(-20, 28, (30, 2)), rng.uniform(0.7, 9, 30)
    wild_ones = np.column_stack([places, 10**powers])
    wild = find_outliers(np.vstack([FIELD, wild_ones]))
    assert wild[-30:].all()
    assert not wild[:-30].any()


def test_a_submap_without_its_wild_points_is_the_submap_as_it_was() -> None:
    rng = np.random.default_rng(1)
    of_points = {
        "colors": rng.uniform(size=(3000, 3)),
        "noise_std": rng.uniform(0.01, 0.02, 3000),
        "ranges": rng.uniform(1, 8, 3000),
    }
    clean = Submap.from_points(FIELD, **of_points)
    row = {name: np.insert(values, 17, values[0], axis=0) for name, values in of_points.items()}
    spoilt = Submap.from_points(np.insert(FIELD, 17, (0.0, 0.0, 1e3), axis=0), **row)
    assert (clean.num_wild, spoilt.num_wild, spoilt.num_points) == (0, 1, 3000)
    assert spoilt.fingerprint == clean.fingerprint


@given(seed=st.integers(0, 2**32 - 1), num=st.integers(50, 2000), slope=st.floats(-1.5, 1.5))
@example(seed=0, num=50, slope=1.5)
def test_ground_has_none(seed: int, num: int, slope: float) -> None:
    points = cloud(seed, num, (8.0, 8.0), holes=3)
    points[:, 2] += slope * points[:, 0]
    assert not find_outliers(points).any()


@pytest.mark.parametrize(
    ("x", "y", "spread", "sign"),
    [(3.0, 5.0, 0.01, 1), (3.0, 5.0, 0.1, -1), (10.0, 9.5, 0.1, 1), (10.0, 9.5, 0.01, -1)],
)
def test_a_swarm_is_found_on_steep_ground(x: float, y: float, spread: float, sign: int) -> None:
    points = cloud(3, 10_000, (8.0, 8.0), holes=3)
    points[:, 2] += 0.6 * points[:, 0] - 0.05 * points[:, 0] * points[:, 1]
    rng = np.random.default_rng(4)
    distance, nearest = cKDTree(points[:, :2]).query((x, y))
    height = points[nearest, 2] + sign * (1.5 + 2 * distance)
    swarm = rng.normal((x, y, height), spread, (60, 3))
    outlier = find_outliers(np.vstack([points, swarm]))
    assert outlier[-60:].all()
    assert not outlier[:-60].any()


def test_walls_bushes_and_strips_are_not_wild() -> None:
    rng = np.random.default_rng(2)
    wall = np.column_stack([np.full(200, 4.0), rng.uniform(2, 6, 200), rng.uniform(0, 3, 200)])
    bush = rng.uniform((1, 1, 0.5), (2, 2, 1.5), (100, 3))
    assert not find_outliers(np.vstack([FIELD, wall, bush])).any()
    strip = rng.uniform(0, (1e6, 200.0, 1.0), (60, 3))
    assert not find_outliers(strip).any()


def test_clouds_of_few_points_or_without_noise_or_extent_have_none() -> None:
    x, y = np.meshgrid(np.arange(20.0), np.arange(20.0))
    plane = np.column_stack([x.ravel(), y.ravel(), np.zeros(400)])
    stone = plane.copy()
    stone[210, 2] = 0.05
    few = [cloud(3, num) * (1, 1, 1000) for num in (0, 3, 49)]
    for points in (plane, stone, plane * (1, 0, 1), plane * 0.0, np.repeat(plane[:1], 99, 0), *few):
        assert not find_outliers(points).any()
