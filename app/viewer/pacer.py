"""A pacer: does something for whoever asks, but not more often than makes sense."""

import logging
import threading
import time
from collections.abc import Callable, Hashable
from typing import Generic, TypeVar

_log = logging.getLogger(__name__)

K = TypeVar("K", bound=Hashable)


class Pacer(Generic[K]):
    """One thread that acts for each key that has asked, and then pauses.

    Whoever asks during the pause is served after it, once, so the last wish is always fulfilled.
    """

    def __init__(self, act: Callable[[K], None], pause: float, name: str) -> None:
        """Start the thread.

        Args:
            act: Given the key; an error in it is logged.
            pause: After each round [s].
            name: Of the thread, for debuggers.
        """
        self._act = act
        self._pause = pause
        self._asked: dict[K, None] = {}
        self._busy = False
        self._closing = False
        self._changed = threading.Condition()
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self._thread.start()

    def ask(self, key: K) -> None:
        """Have it act for a key soon; returns at once."""
        with self._changed:
            self._asked[key] = None
            self._changed.notify_all()

    def wait_idle(self, timeout: float) -> bool:
        """Wait until nobody waits; says whether that came true within the timeout [s]."""
        with self._changed:
            return self._changed.wait_for(lambda: not self._asked and not self._busy, timeout)

    def close(self) -> None:
        """Stop; who still waits is not served."""
        with self._changed:
            self._closing = True
            self._changed.notify_all()
        if self._thread is not threading.current_thread():
            self._thread.join()

    def _run(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._asked or self._closing)
                if self._closing:
                    return
                asked, self._asked, self._busy = self._asked, {}, True
            for key in asked:
                try:
                    self._act(key)
                except Exception:
                    _log.exception("could not be done")
            with self._changed:
                self._busy = False
                self._changed.notify_all()
                end = time.monotonic() + self._pause
                while not self._closing and (left := end - time.monotonic()) > 0:
                    self._changed.wait(left)
