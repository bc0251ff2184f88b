"""Submaps from standard input, or from any other stream of frames."""

import threading
from collections.abc import Iterator

from gpgrad_core.errors import InputError
from gpgrad_core.live.frames import Hello, Receive, contents, from_robot
from gpgrad_core.live.source import News, Silent, Trouble, arrival_of


class Stream(Silent):
    """Reads frames until the stream ends; it answers nobody."""

    def __init__(self, receive: Receive, name: str = "standard input") -> None:
        """Read what a function gives, such as the `read` of a file without a buffer."""
        self._receive, self.name = receive, name

    def news(self, stopped: threading.Event) -> Iterator[News]:
        for content in contents(self._receive, self.name):
            if stopped.is_set():
                return
            message = from_robot(content, self.name)
            if isinstance(message, Hello):
                continue
            try:
                yield arrival_of(message)
            except InputError as error:
                yield Trouble(str(error))
