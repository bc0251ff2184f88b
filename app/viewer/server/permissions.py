"""What a viewer may read and write."""

from dataclasses import dataclass
from pathlib import Path

MAX_UPLOAD = 200_000_000


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
    """

    config: Path | None = None
    root: Path | None = None
    uploads: Path | None = None
    max_upload: int = MAX_UPLOAD

    @property
    def presets(self) -> Path | None:
        """Folder of the user's own presets."""
        return None if self.config is None else self.config / "presets"


READ_ALL = Permissions()
"""Read whatever the person who started the viewer can read; keep nothing, take no uploads."""
