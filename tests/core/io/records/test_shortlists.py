"""A shortlist on disk: it comes back as it went, and a damaged one is made anew."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from gpgrad_core.detection.shortlist import Shortlist
from gpgrad_core.io.records.shortlists import (
    ARRAYS,
    read_shortlist,
    resume_shortlist,
    write_shortlist,
)
from gpgrad_core.types import Features
from tests.core.detection.places import LEARN_FROM, features, learning_early, nothing
from tests.support.refusal import assert_refused


@pytest.fixture(scope="module", autouse=True)
def _early() -> Iterator[None]:
    with learning_early():
        yield


def places(count: int) -> list[tuple[str, Features]]:
    return [(f"{k:03}", nothing() if k == 5 else features(k, 100)) for k in range(count)]


@pytest.fixture(scope="module", params=[0, 7, LEARN_FROM + 6], ids=["none", "few", "many"])
def shortlist(request: pytest.FixtureRequest) -> Shortlist:
    made = Shortlist(3)
    for id, keypoints in places(request.param):
        made.add(id, keypoints)
    return made


def test_it_comes_back_as_it_went_and_goes_on(shortlist: Shortlist, tmp_path: Path) -> None:
    path = tmp_path / "shortlist.npz"
    write_shortlist(path, shortlist)
    back = read_shortlist(path)
    assert (back.ids, back.seed) == (shortlist.ids, 3)
    query = features(2, 100, noise=0.2)
    assert back.candidates(query, 9) == shortlist.candidates(query, 9)
    go_on, plain = read_shortlist(path), read_shortlist(path)
    for k in range(200, 200 + LEARN_FROM):
        go_on.add(str(k), features(k, 100))
        plain.add(str(k), features(k, 100))
    assert go_on.candidates(query, 9) == plain.candidates(query, 9)
    write_shortlist(path, go_on)
    assert read_shortlist(path).candidates(query, 9) == go_on.candidates(query, 9)


def test_only_new_submaps_are_added(tmp_path: Path) -> None:
    path, submaps = tmp_path / "shortlist.npz", places(LEARN_FROM + 6)
    first, notes = resume_shortlist(path, submaps[:-3])
    assert notes == ()
    second, notes = resume_shortlist(path, submaps)
    assert notes == ()
    assert (len(first), len(second)) == (LEARN_FROM + 3, LEARN_FROM + 6)
    whole = Shortlist()
    for id, keypoints in submaps:
        whole.add(id, keypoints)
    query = features(9, 100, noise=0.2)
    assert second.candidates(query, 30) == whole.candidates(query, 30)


@pytest.mark.parametrize("damage", ["cut", "flipped", "other", *ARRAYS])
def test_a_damaged_one_is_made_anew_and_said(damage: str, tmp_path: Path) -> None:
    path, submaps = tmp_path / "shortlist.npz", places(LEARN_FROM + 6)
    resume_shortlist(path, submaps)
    whole = path.read_bytes()
    if damage == "cut":
        path.write_bytes(whole[: len(whole) // 2])
    elif damage == "flipped":
        middle = len(whole) // 2
        path.write_bytes(whole[:middle] + bytes([whole[middle] ^ 255]) + whole[middle + 1 :])
    elif damage == "other":
        resume_shortlist(path, [(f"x{id}", keypoints) for id, keypoints in submaps])
    else:
        with np.load(path) as archive:
            arrays = dict(archive)
        array = arrays[damage]
        arrays[damage] = array + 1 if array.ndim == 0 else array[:-1]
        np.savez(path, **arrays)
    again, notes = resume_shortlist(path, submaps)
    (note,) = notes
    assert note.startswith(f"{path}: ")
    assert note.endswith("; it is made anew")
    assert again.ids == tuple(id for id, _ in submaps)
    assert resume_shortlist(path, submaps)[1] == ()


@pytest.mark.parametrize("name", sorted(ARRAYS))
def test_every_array_is_checked(name: str, tmp_path: Path) -> None:
    path = tmp_path / "shortlist.npz"
    resume_shortlist(path, places(LEARN_FROM + 6))
    with np.load(path) as archive:
        arrays = dict(archive)
    wrong = [(arrays[name].astype("c8"), f"'{name}' is complex64"), (None, f"no array '{name}'")]
    if arrays[name].dtype.kind == "f":
        spoiled = np.full_like(arrays[name], np.nan)
        wrong.append((spoiled, f"'{name}' has a number that is not finite"))
    for array, rule in wrong:
        held = arrays | {name: array}
        np.savez(path, **{key: one for key, one in held.items() if one is not None})
        assert_refused(lambda: read_shortlist(path), rule)
