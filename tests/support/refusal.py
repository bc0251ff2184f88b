"""What every refusal promises: one line that names the place and the rule."""

from collections.abc import Callable
from pathlib import Path

import pytest

from gpgrad_core.errors import InputError


def assert_refused(action: Callable[[], object], *parts: str) -> None:
    with pytest.raises(InputError) as caught:
        action()
    message = str(caught.value)
    assert "\n" not in message
    for part in parts:
        assert part in message


def assert_file_refused(
    read: Callable[[Path], object], path: Path, content: str | bytes, *parts: str
) -> None:
    """Write a file, and fail unless it is refused in a line with its path and these parts."""
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    assert_refused(lambda: read(path), str(path), *parts)
