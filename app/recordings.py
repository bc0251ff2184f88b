"""Errors where a dataset is expected and the path is a recording, a run or an archive."""

import contextlib
import shlex
import tarfile
import zipfile
from collections.abc import Generator
from pathlib import Path

from gpgrad_core.errors import InputError
from gpgrad_core.io.clouds import is_cloud


@contextlib.contextmanager
def built_first(path: Path) -> Generator[None]:
    """Explain how to open what cannot be read as a dataset, such as a recording of scans."""
    try:
        yield
    except InputError as error:
        from gpgrad_core.recordings.build import is_recording  # noqa: PLC0415 - loads slowly
        from gpgrad_core.slam.run_file import is_run  # noqa: PLC0415

        given, other = shlex.quote(str(path)), path.is_file() and not is_cloud(path)
        if other and is_run(path):
            raise InputError(
                f"{path}: is the record of a drive, not a dataset: gpgrad view {given} shows it; "
                "other commands take the dataset that it was made of"
            ) from error
        if other and (zipfile.is_zipfile(path) or tarfile.is_tarfile(path)):
            raise InputError(f"{path}: is an archive: unpack it, and name its folder") from error
        if not is_recording(path):
            raise
        out = shlex.quote(f"{path.resolve().stem}-submaps")
        raise InputError(
            f"{path}: is a recording, not a dataset: build its submaps first, and open these: "
            f"gpgrad build {given} --out {out}"
        ) from error
