"""Submaps from standard input, or from any other stream of frames."""

import threading
from collections.abc import Iterator
from io import BufferedIOBase

from gpgrad_core.errors import InputError
from gpgrad_core.live.frames import Hello, contents, from_robot, reading
from gpgrad_core.live.source import News, Silent, Trouble, arrival_of


class Stream(Silent):
    """Reads frames until the stream ends; nobody is told that a submap is kept."""

    def __init__(self, stream: BufferedIOBase, name: str = "standard input") -> None:
        """Read a stream that is open already."""
        self._stream, self.name = stream, name

    def news(self, stopped: threading.Event) -> Iterator[News]:
        """Wait for frames.

        Raises:
            InputError: If what comes is no frame: where the next one begins is unknown then.
        """
        for content in contents(reading(self._stream), self.name):
            if stopped.is_set():
                return
            message = from_robot(content, self.name)
            if isinstance(message, Hello):
                continue
            try:
                yield arrival_of(message)
            except InputError as error:
                yield Trouble(str(error))
