"""A shortlist as a file, so that a later run need not make it again."""

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from gpgrad_core.arrays import NDArray
from gpgrad_core.detection.shortlist import Shortlist, ShortlistState, Vocabulary
from gpgrad_core.errors import InputError
from gpgrad_core.io.clouds.npy import Load, opened_npz
from gpgrad_core.io.records.files import replacing
from gpgrad_core.types import Features

VERSION = 1
"""Of the file's format; a file of another version is made anew."""
ARRAYS: dict[str, tuple[str, int]] = {
    "version": ("i8", 0),
    "seed": ("i8", 0),
    "ids": ("u1", 1),
    "mean": ("f4", 1),
    "axes": ("f4", 2),
    "words": ("f4", 2),
    "global_vectors": ("f4", 2),
    "num_descriptors": ("i8", 1),
    "descriptors": ("f4 f2", 2),
    "num_voters": ("i8", 1),
    "positions": ("f4", 2),
    "tolerances": ("f8", 1),
}
"""The arrays of a file, each with its possible types and its number of dimensions."""
OF_VOCABULARY = ("mean", "axes", "words")


def write_shortlist(path: Path | str, shortlist: Shortlist) -> None:
    """Write a shortlist, completely or not at all.

    Args:
        path: The file, an NPZ archive.
        shortlist: What to write.

    Raises:
        InputError: If the file cannot be written there.
        OSError: If writing fails.
    """
    state = shortlist.state
    none = np.zeros((0, 0), np.float32)
    vocabulary = state.vocabulary or Vocabulary(none[0:0].ravel(), none, none)
    arrays = {"version": np.array(VERSION), "seed": np.array(state.seed)}
    arrays["ids"] = np.frombuffer("\n".join(state.ids).encode(), np.uint8)
    for name in list(ARRAYS)[len(arrays) :]:
        arrays[name] = getattr(vocabulary if name in OF_VOCABULARY else state, name)
    with replacing(path) as unfinished, unfinished.open("wb") as file:
        np.savez(file, allow_pickle=False, **arrays)


def read_shortlist(path: Path | str) -> Shortlist:
    """Read a shortlist that `write_shortlist` wrote.

    Raises:
        InputError: If the file is damaged, or its arrays do not fit each other; the message names
            the file and the array.
        OSError: If the file cannot be read.
    """
    path = Path(path)
    with opened_npz(path) as held:
        arrays = {name: _array(path, held, name) for name in ARRAYS}
    return Shortlist.restored(_state(path, arrays))


def resume_shortlist(
    path: Path | str, submaps: Iterable[tuple[str, Features]], seed: int = 0
) -> tuple[Shortlist, tuple[str, ...]]:
    """Read a shortlist, add the submaps that it lacks, and write it.

    Args:
        path: The file; it need not exist.
        submaps: Id and keypoints of all submaps in order. The file must hold the first of them.
        seed: Seed of the random choices.

    Returns:
        The shortlist of all submaps, and notes for the user: why it was made anew, if it was.

    Raises:
        InputError: If the file cannot be written, or submaps have different descriptors.
        OSError: If reading or writing fails.
    """
    path, ordered = Path(path), list(submaps)
    shortlist, notes = Shortlist(seed), tuple[str, ...]()
    if path.exists():
        try:
            earlier = read_shortlist(path)
            if earlier.seed != seed or earlier.ids != tuple(
                id for id, _ in ordered[: len(earlier)]
            ):
                raise InputError(f"{path}: is the shortlist of other submaps or another seed")
            shortlist = earlier
        except InputError as error:
            notes = (f"{error}; it is made anew",)
    if len(shortlist) < len(ordered):
        for id, features in ordered[len(shortlist) :]:
            shortlist.add(id, features)
        write_shortlist(path, shortlist)
    return shortlist, notes


def _array(path: Path, held: dict[str, Load], name: str) -> NDArray[Any]:
    """Load an array of the types and dimensions that it must have, of finite numbers."""
    if name not in held:
        raise InputError(f"{path}: is no shortlist: it has no array {name!r}")
    array = held[name]()
    kinds, dimensions = ARRAYS[name]
    if array.dtype.str[1:] not in kinds.split() or array.ndim != dimensions:
        raise InputError(
            f"{path}: array {name!r} is {array.dtype} {array.shape}, which no shortlist has"
        )
    if array.dtype.kind == "f" and not np.isfinite(array).all():
        raise InputError(f"{path}: array {name!r} has a number that is not finite")
    return array


def _state(path: Path, arrays: dict[str, NDArray[Any]]) -> ShortlistState:
    """Check that the arrays fit each other."""

    def check(name: str, right: bool | np.bool_) -> None:
        if not right:
            raise InputError(f"{path}: array {name!r} does not fit the others")

    if int(arrays["version"]) != VERSION:
        raise InputError(f"{path}: is of version {int(arrays['version'])}, not {VERSION}")
    try:
        text = arrays["ids"].tobytes().decode()
    except UnicodeDecodeError:
        raise InputError(f"{path}: array 'ids' is no text") from None
    counts, voters = arrays["num_descriptors"], arrays["num_voters"]
    ids = tuple(text.split("\n")) if len(counts) else ()
    check("ids", len(set(ids)) == len(counts))
    check("num_descriptors", (counts >= 0).all() and counts.sum() == len(arrays["descriptors"]))
    check("num_voters", voters.shape == counts.shape and (voters >= 0).all())
    check("num_voters", (voters <= counts).all())
    check("positions", arrays["positions"].shape == (voters.sum(), 2))
    check("tolerances", arrays["tolerances"].shape == counts.shape)
    check("tolerances", (arrays["tolerances"] >= 0).all())
    mean, axes, words = (arrays[name] for name in OF_VOCABULARY)
    if len(words):
        check("mean", len(mean) == len(axes) > 0)
        check("axes", axes.shape[1] == words.shape[1])
        check("descriptors", arrays["descriptors"].shape[1] == words.shape[1])
        check("num_voters", (voters == counts).all())
    check("global_vectors", arrays["global_vectors"].shape == (len(counts), words.size))
    vocabulary = Vocabulary(mean, axes, words) if len(words) else None
    rest = {name: arrays[name] for name in list(ARRAYS)[3:] if name not in OF_VOCABULARY}
    return ShortlistState(int(arrays["seed"]), ids, vocabulary, **rest)
