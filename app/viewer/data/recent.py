"""The list of recent datasets, which outlives the viewer."""

import json
import logging
from pathlib import Path
from typing import cast

from gpgrad_core.errors import InputError
from gpgrad_core.outputs import replacing
from gpgrad_core.reading.json_files import read_json
from gpgrad_core.reading.paths import check_path

_log = logging.getLogger(__name__)

MOST = 8
FILE = "recent.json"
LARGEST = 100_000
"""Bytes; eight paths have a tenth."""


def recent_datasets(config: Path) -> tuple[str, ...]:
    """Read the paths of the datasets opened last, newest first, without those that are gone.

    Args:
        config: Folder of the user's settings; it need not exist.
    """
    try:
        paths = read_json(config / FILE, LARGEST)
    except (OSError, InputError):
        return ()  # the first time, or not worth an error
    if not isinstance(paths, list):
        return ()
    found = [path for path in cast("list[object]", paths) if isinstance(path, str)]
    return tuple(path for path in found if _is_there(path))[:MOST]


def _is_there(path: str) -> bool:
    try:
        return check_path(path).exists()
    except InputError:
        return False


def remember_dataset(config: Path, path: str) -> tuple[str, ...]:
    """Put a dataset first among the recent ones; returns them all.

    A list that cannot be written is lost with the viewer, and that goes to the log: opening
    worked.

    Args:
        config: Folder of the user's settings; made if need be.
        path: Of the dataset.
    """
    paths = tuple(dict.fromkeys((path, *recent_datasets(config))))[:MOST]
    try:
        config.mkdir(parents=True, exist_ok=True)
        with replacing(config / FILE) as unfinished:
            unfinished.write_text(json.dumps(paths, indent=1), encoding="utf-8")
    except (OSError, ValueError) as error:
        _log.warning("recent datasets were not saved: %s", error)
    return paths
