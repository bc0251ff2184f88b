"""What can be opened: below a folder, and of the datasets that were open before.

Links are resolved first, so nothing outside of the folder can be opened.
"""

import contextlib
import json
import logging
import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import cast

from gpgrad_core.errors import InputError
from gpgrad_core.io.clouds import is_cloud
from gpgrad_core.io.poses import is_posed_scan
from gpgrad_core.io.records.files import replacing
from gpgrad_core.reading.paths import check_path
from gpgrad_core.reading.records import read_json

SUBFOLDERS = frozenset({"submaps", "scans", "velodyne", "clouds"})
"""A folder with one of these is a dataset, or a recording."""
BAGS = frozenset({".bag", ".mcap", ".db3"})
MOST_ENTRIES = 500
"""Longer lists make the browser slow; what is left out is counted."""


@dataclass(frozen=True)
class Listing:
    """What a user can choose in a folder."""

    folder: Path  # relative to the root; "." is the root itself
    entries: tuple[str, ...]  # folders, which end in "/", and then clouds and bags
    is_dataset: bool  # whether the folder itself can be opened
    num_hidden: int = 0  # entries left out of a long list


def inside(root: Path, path: Path) -> Path:
    """Resolve a path that must lie below a root; of what exists elsewhere nobody learns."""
    real_root = root.resolve()
    with contextlib.suppress(OSError, ValueError, RuntimeError):  # a zero byte; links in a circle
        real = (root / path).resolve(strict=True)
        if real.is_relative_to(real_root):
            return real
    raise InputError(
        f"{path}: no such file or folder in {root}, and this viewer may open nothing else"
    )


def check_inside(root: Path, path: Path) -> Path:
    """Resolve a dataset's path as `inside`, and check that nothing in it is a link to elsewhere."""
    real = inside(root, path)
    for entry in _entries(real):
        if entry.is_symlink():
            inside(root, entry)
    return real


def check_tree(root: Path, path: Path) -> None:
    """Check that nothing in a folder, however deep, is a link out of the root."""
    for parent, folders, files in os.walk(path):
        for entry in (*folders, *files):
            if (Path(parent) / entry).is_symlink():
                inside(root, Path(parent) / entry)


def list_folder(root: Path, folder: Path) -> Listing:
    """List what can be chosen in a folder below the root."""
    real = inside(root, folder)
    if not real.is_dir():
        raise InputError(f"{folder}: is not a folder")
    folders: list[str] = []
    clouds: list[str] = []
    try:
        found = sorted(real.iterdir())
    except OSError as error:
        raise InputError(f"{folder}: cannot be read: {error.strerror or error}") from error
    for entry in found:
        if entry.name.startswith(".") or not entry.resolve().is_relative_to(root.resolve()):
            continue
        if entry.is_dir():
            folders.append(entry.name)
        elif is_cloud(entry) or entry.suffix.lower() in BAGS:
            clouds.append(entry.name)
    entries = (*(f"{name}/" for name in folders[:MOST_ENTRIES]), *clouds[:MOST_ENTRIES])
    return Listing(
        real.relative_to(root.resolve()),
        entries,
        is_dataset=(
            bool(clouds)
            or not SUBFOLDERS.isdisjoint(folders)
            or any(is_posed_scan(real / name) for name in folders)
        ),
        num_hidden=len(folders) + len(clouds) - len(entries),
    )


def _entries(path: Path) -> Iterator[Path]:
    """List all that loading a dataset may read; links to folders are listed but not entered."""
    if path.is_file():
        yield path
        return
    for name in ("", "submaps", "images"):
        folder = path / name
        if not folder.is_dir():
            continue
        deep = name == "images"
        for parent, folders, files in os.walk(folder):
            yield from (Path(parent) / entry for entry in (*folders, *files))
            if not deep:
                break
    # Scans with a pose each lie in a folder each.
    for folder in path.iterdir():
        if is_posed_scan(folder):
            yield from folder.iterdir()


_log = logging.getLogger(__name__)

MOST_RECENT = 8
FILE = "recent.json"
LARGEST = 100_000
"""Bytes; eight paths have a tenth."""


def recent_datasets(config: Path) -> tuple[str, ...]:
    """Read the paths of the datasets opened last, newest first, without those that are gone."""
    try:
        paths = read_json(config / FILE, LARGEST)
    except (OSError, InputError):
        return ()  # the first time, or not worth an error
    if not isinstance(paths, list):
        return ()
    texts = [path for path in cast("list[object]", paths) if isinstance(path, str)]
    return tuple(path for path in texts if _is_there(path))[:MOST_RECENT]


def _is_there(path: str) -> bool:
    try:
        return check_path(path).exists()
    except InputError:
        return False


def remember_dataset(config: Path, path: str) -> tuple[str, ...]:
    """Store a dataset as the first of the recent ones; if that fails, the log has it."""
    paths = tuple(dict.fromkeys((path, *recent_datasets(config))))[:MOST_RECENT]
    try:
        config.mkdir(parents=True, exist_ok=True)
        with replacing(config / FILE) as unfinished:
            unfinished.write_text(json.dumps(paths, indent=1), encoding="utf-8")
    except (OSError, ValueError) as error:
        _log.warning("recent datasets were not saved: %s", error)
    return paths
