"""Kept submaps are what was given; what a killed process has not finished is cut off."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gpgrad_core.live.keeping import Keeper
from gpgrad_core.types import Submap
from tests.core.live.submaps import assert_same_submap, row
from tests.support.refusal import assert_refused

FEW = row(3)


def kept(path: Path, submaps: list[Submap]) -> bytes:
    keeper = Keeper(path)
    for submap in submaps:
        assert keeper.keep(submap)
    keeper.close()
    return path.read_bytes()


@pytest.mark.parametrize("named", [True, False])
def test_a_kept_submap_is_the_same(tmp_path: Path, named: bool) -> None:
    keeper = Keeper(tmp_path / "run.submaps" if named else None)
    full = Submap.from_points(
        np.vstack([FEW[0].points, [[0.0, 0.0, 50.0]]]),
        "full_9",
        pose_odometry=FEW[0].pose_odometry,
        noise_std=np.full(61, 0.1),
        ranges=np.full(61, 3.0),
        colors=np.full((61, 3), 0.5),
    )
    for submap in (*FEW, full):
        assert keeper.keep(submap)
    assert keeper.names == ("000", "001", "002", "full_9")
    for submap in (*FEW, full):
        assert_same_submap(keeper.submap(submap.id), submap)
    given = keeper.submap("001")
    with pytest.raises(ValueError, match="read-only"):
        given.points[0, 0] = 1.0
    keeper.close()
    assert_same_submap(given, FEW[1])  # what was given back outlives the file


def test_an_id_comes_once(tmp_path: Path) -> None:
    keeper = Keeper(tmp_path / "kept")
    assert keeper.keep(FEW[0])
    assert not keeper.keep(FEW[0])
    other = replace(FEW[1], id="000")
    assert_refused(lambda: keeper.keep(other), "000", "another content")
    assert_refused(lambda: keeper.keep(replace(FEW[1], pose_odometry=None)), "no odometry pose")
    assert_refused(lambda: Keeper(tmp_path / "kept"), "another viewer")
    keeper.close()


def test_whatever_is_cut_off_the_promised_ones_stay(tmp_path: Path) -> None:
    path = tmp_path / "kept"
    ends = [len(kept(path, FEW[:0]))]
    for count in range(3):
        keeper = Keeper(path)
        keeper.keep(FEW[count])
        keeper.close()
        ends.append(path.stat().st_size)
    whole = path.read_bytes()
    rng = np.random.default_rng(0)
    for end in [0, 5, *ends, *rng.integers(0, len(whole), 40).tolist()]:
        path.write_bytes(whole[:end])
        keeper = Keeper(path)
        promised = [submap.id for submap, after in zip(FEW, ends[1:], strict=True) if after <= end]
        assert list(keeper.names) == promised
        for submap in FEW:  # and it goes on from there
            assert keeper.keep(submap) == (submap.id not in promised)
            assert_same_submap(keeper.submap(submap.id), submap)
        keeper.close()
        assert path.read_bytes() == whole


def test_damage_is_said(tmp_path: Path) -> None:
    path = tmp_path / "kept"
    whole = kept(path, FEW)
    place = whole.index(FEW[0].points.astype("<f8").tobytes()) + 100
    path.write_bytes(whole[:place] + bytes([whole[place] ^ 1]) + whole[place + 1 :])
    assert_refused(lambda: Keeper(path), "kept", "submap 000 is damaged")
    path.write_text("# my notes, which nobody wants to lose\n" * 10)
    assert_refused(lambda: Keeper(path), "not a file of kept submaps")
    assert path.read_text().startswith("# my notes")
