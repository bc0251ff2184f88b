"""What the viewer may read and write, and how much pages may ask, so that none takes it all."""

from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Permissions:
    """Folders and sizes that the person who starts the viewer allows it to use.

    Attributes:
        config: Folder of the user's own presets and the list of recent datasets; None keeps
            neither.
        root: Datasets outside of this folder are not opened, except the demo and uploads; None
            allows whatever the person who started the viewer can read.
        uploads: Existing folder for what pages upload, which its maker removes; None allows no
            uploads.
        max_upload: Largest file that can be uploaded [bytes]. An archive may unpack to
            `app.viewer.features.data.unpacking.MOST_GROWTH` times as much.
        writes: Whether pages may have datasets built, in new folders inside of the root, if any.
    """

    config: Path | None = None
    root: Path | None = None
    uploads: Path | None = None
    max_upload: int = 200_000_000
    writes: bool = False

    @property
    def presets(self) -> Path | None:
        """Folder of the user's own presets."""
        return None if self.config is None else self.config / "presets"


READ_ALL = Permissions()
"""Read whatever the person who started the viewer can read; keep nothing, take no uploads."""


@dataclass(frozen=True)
class Limits:
    """What is served at once, and how fast.

    Attributes:
        pages: Open pages.
        waiting: Connections that are not a page yet: half of a request, or an answer that nobody
            fetches. The oldest are dropped first.
        rate: Turns that a page may have [1/s]. It has to wait for more, and is not refused.
        messages: That wait for a page's turn and that nothing newer replaces. It is read on when
            there are fewer.
        message_bytes: The largest message; a picture of the page is the largest that there is.
        unfinished_bytes: What all pages together may have begun to send and not ended.
        upload_bytes: The largest file that may be uploaded, and all that are under way at once.
        uploads: Files of one page that are under way.
        idle_seconds: An upload of which nothing has come for so long is dropped [s].
        typing_seconds: A value that cannot be taken is refused so long after it came [s]: a person
            who types 15 where 10 is the least has typed 1 before.
    """

    pages: int = 100
    waiting: int = 256
    rate: float = 250.0
    messages: int = 32
    message_bytes: int = 32_000_000
    unfinished_bytes: int = 150_000_000
    upload_bytes: int = 0
    uploads: int = 4
    idle_seconds: float = 60.0
    typing_seconds: float = 1.0
