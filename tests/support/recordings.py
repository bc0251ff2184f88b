"""Opens recordings, and says what is refused of them."""

from pathlib import Path
from typing import Any

from gpgrad_core.recordings.build import open_recording
from gpgrad_core.recordings.recording import Recording, RecordingSources
from tests.support.refusal import assert_refused


def opened(path: Path, **sources: Any) -> Recording:
    return open_recording(path, RecordingSources(**sources))


def refused(path: Path, *parts: str, sources: RecordingSources | None = None, **named: Any) -> None:
    """Fail unless the recording, or its first scan, is refused in a line with these parts."""
    sources = sources or RecordingSources(**named)
    assert_refused(lambda: list(open_recording(path, sources).read(0, 1)), *parts)
