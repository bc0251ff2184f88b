"""What a tab or tool of the viewer may want to know of the session that it is part of."""

from app.viewer.state import ViewState
from gpgrad_core.pipeline import PairResult


class Part:
    """Follows a session; the session tells every part of what happens. All of it is optional."""

    def follow(self, state: ViewState) -> None:
        """Take the session as it is now; called at every change of anything, so be quick."""

    def show(self, state: ViewState, result: PairResult) -> None:
        """Take what was found for a state, after the scene has shown it.

        Called from the worker that makes the pictures: what takes longer than a few milliseconds
        belongs to a `Runner` of the part's own.
        """

    def wait_idle(self, timeout: float) -> bool:  # noqa: ARG002 - those with workers wait
        """Wait until nothing runs; says whether that came true within the timeout [s]."""
        return True

    def close(self) -> None:
        """Stop whatever runs."""
