"""What was opened, and the first snapshot that is made of it."""

from dataclasses import dataclass

from app.viewer.session_file import SavedSession
from app.viewer.state import ViewOptions, ViewState, open_dataset
from gpgrad_core.pipeline import PipelineParams
from gpgrad_core.types import Dataset


@dataclass(frozen=True, eq=False)
class Opened:
    """A dataset that was read, and what to start it with.

    Attributes:
        dataset: The submaps.
        params: What "Reset parameters" goes back to, as it was given.
        source: Path that it was read from.
        saved: Pair, parameters and view to begin with; None begins as the dataset prefers.
        used: What `resolve_parameters` made of the parameters; None if it was not asked yet.
    """

    dataset: Dataset
    params: PipelineParams
    source: str
    saved: SavedSession | None = None
    used: PipelineParams | None = None

    def begin(self, options: ViewOptions) -> ViewState:
        """Make the first snapshot.

        Args:
            options: Of the view, unless a saved session comes with its own.
        """
        state = open_dataset(self.dataset, self.params, options, self.source, self.used)
        return state if self.saved is None else self.saved.apply(state)
