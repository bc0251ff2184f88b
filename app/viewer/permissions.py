"""Where a viewer may read from and write to."""

from dataclasses import dataclass
from pathlib import Path

MAX_UPLOAD = 200_000_000


@dataclass(frozen=True)
class Places:
    """Folders that the person who starts the viewer allows it to use.

    Attributes:
        config: For the user's own presets and the list of recent datasets; None keeps neither.
        root: Outside of which no dataset is opened, but the demo and what is uploaded; None allows
            whatever the person who started the viewer can read.
        uploads: For what pages upload, an existing folder that its maker removes; None allows no
            uploads.
        max_upload: Largest file that can be uploaded [bytes]; an archive may unpack to
            `app.viewer.data.unpacking.MOST_GROWTH` times as much.
    """

    config: Path | None = None
    root: Path | None = None
    uploads: Path | None = None
    max_upload: int = MAX_UPLOAD

    @property
    def presets(self) -> Path | None:
        """Folder of the user's own presets."""
        return None if self.config is None else self.config / "presets"


ANYWHERE = Places()
"""Whatever the person who started the viewer can read; nothing kept, nothing uploaded."""
