"""``gpgrad demo``: a simulated rover drives, live in the viewer, and closes its loop."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

from typing_extensions import Doc

from app.cli.terminal import say
from app.cli.view import Serving
from app.viewer.viewer import OpeningProgress
from gpgrad_core.run.memo import Memo

if TYPE_CHECKING:  # loaded when they are needed: a page is served before
    from app.viewer.session.session_file import Opened


@dataclass(frozen=True)
class Demo(Serving):
    """Arguments of ``gpgrad demo``."""

    seed: Annotated[int, Doc("Seed of the ground, the drive and its drift.")] = 43

    def run(self) -> None:
        self.check()
        self.serve(self._opened, "a simulated drive")

    def _opened(self, memo: Memo, stage: OpeningProgress) -> "Opened":
        from app.viewer.session.following import begin_drive  # noqa: PLC0415 - loads slowly

        opened = begin_drive(self.seed, memo, stage, stage.show)
        say("The rover drives")
        return opened
