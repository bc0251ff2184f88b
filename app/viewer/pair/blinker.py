"""Shows two submaps in turn, so that the eye finds the differences."""

import threading

from app.viewer.draw.nodes import SubmapNode
from app.viewer.host import Host

PERIOD = 0.8
"""How long each is seen [s]."""


class Blinker:
    """Shows the query and the database in turn, from a thread of its own.

    A blink is one message of a few bytes; the surfaces stay in the browser.
    """

    def __init__(self, host: Host, nodes: tuple[SubmapNode, SubmapNode]) -> None:
        """Prepare to blink; `run` begins.

        Args:
            host: Whose scene the nodes are in.
            nodes: The query's and the database's.
        """
        self._host = host
        self._nodes = nodes
        self._stop = threading.Event()
        self._thread: threading.Thread | None = None

    @property
    def on(self) -> bool:
        """Whether it blinks."""
        return self._thread is not None

    def run(self, *, on: bool) -> None:
        """Begin or end; both are visible when it ends."""
        if on == self.on:
            return
        if not on:
            self.close()
            with self._host.atomic():
                for node in self._nodes:
                    node.visible = True
            self._host.flush()
            return
        self._stop.clear()
        self._thread = threading.Thread(target=self._blink, name="blinker", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """End, leaving the nodes as they are."""
        if self._thread is not None:
            self._stop.set()
            self._thread.join()
            self._thread = None

    def _blink(self) -> None:
        shown = 0
        while not self._stop.wait(PERIOD):
            with self._host.atomic():
                for index, node in enumerate(self._nodes):
                    node.visible = index == shown
            self._host.flush()
            shown = 1 - shown
