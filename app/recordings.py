"""What to say where a dataset is expected and a recording of scans is given."""

import contextlib
import shlex
from collections.abc import Generator
from pathlib import Path

from gpgrad_core.errors import InputError


@contextlib.contextmanager
def built_first(path: Path) -> Generator[None]:
    """Say how to build submaps if a dataset that cannot be read is a recording of scans."""
    try:
        yield
    except InputError as error:
        from gpgrad_core.recordings.build import is_recording  # noqa: PLC0415 - loads slowly

        if not is_recording(path):
            raise
        given = shlex.quote(str(path))
        out = shlex.quote(f"{path.resolve().stem}-submaps")
        raise InputError(
            f"{path}: is a recording, not a dataset: build its submaps first, and open these: "
            f"gpgrad build {given} --out {out}"
        ) from error
