"""What stands on the ground is left out, and bare ground stays as it is."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gpgrad_core.arrays import Array
from gpgrad_core.errors import InputError
from gpgrad_core.ground import find_non_ground
from gpgrad_core.io.folder import load_dataset, write_dataset
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
    count = filtered.submaps[0].num_standing
    assert f"{count:,} of {len(points):,} points were left out: they stand on the gr" in str(
        filtered.notes
    )
    (folder / "dataset.toml").write_text('ground = "some"\n')
    with pytest.raises(InputError, match=r"dataset\.toml.*ground"):
        load_dataset(folder)
