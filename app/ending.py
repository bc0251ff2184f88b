"""How the program ends when it is stopped: by Ctrl-C, by SIGTERM, or because its terminal closed.

All of them take the way out of Ctrl-C, an exception in the main thread, so that every verb leaves
its temporary files and its processes in one way. This module is loaded before everything else and
loads nothing that takes time.
"""

import contextlib
import io
import os
import signal
import sys
import threading
from collections.abc import Generator
from types import FrameType
from typing import Any

INTERRUPTED = 130
AGAIN = 0.05
"""Time after which a signal that was dropped is raised once more [s]."""
UNREAD = 141
"""As shells count SIGPIPE, which ends other commands before ``| head``."""


def open_streams() -> None:
    """Connect streams that were closed from the start to nowhere, and let them take any character.

    Otherwise the next file that is opened would take the place of a closed one, and what is printed
    there would go into it. What a terminal cannot show is spelled out.
    """
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        if getattr(sys, name) is None:
            nowhere = os.open(os.devnull, os.O_RDWR)  # the lowest number that is free: its own
            os.set_inheritable(nowhere, True)
            setattr(sys, name, os.fdopen(nowhere, mode, encoding="utf-8"))
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")


class Terminated(KeyboardInterrupt):
    """Raised in the main thread on a signal to end."""

    def __init__(self, number: int = signal.SIGTERM) -> None:
        super().__init__("terminated")
        self.exit_code = 128 + number


@contextlib.contextmanager
def termination_raised() -> Generator[None]:
    """Raise `Terminated` where SIGTERM or SIGHUP arrives, until the block ends.

    A signal that is ignored stays ignored, as ``nohup`` wants it. Outside of the main thread,
    where Python allows no handlers, nothing changes. Ctrl-C raises as always, and is noted for
    `stopped_by`. Where nothing can be raised, as while an object is removed, Python drops what is
    raised: then it is raised once more, a moment later.
    """
    usual = (signal.SIG_DFL, signal.default_int_handler)
    numbers = [getattr(signal, name, None) for name in ("SIGINT", "SIGTERM", "SIGHUP")]
    before: dict[int, Any] = {}
    if threading.current_thread() is threading.main_thread():
        handlers = {n: signal.getsignal(n) for n in numbers if n is not None}  # not all on Windows
        before = {n: handler for n, handler in handlers.items() if handler in usual}
    dropped = sys.unraisablehook
    if before:
        _heard.clear()
        sys.unraisablehook = _raise_again
    try:
        for number in before:
            signal.signal(number, _raise)
        yield
    finally:
        sys.unraisablehook = dropped
        for number, handler in before.items():
            signal.signal(number, handler)


_heard: list[KeyboardInterrupt] = []


def _raise(number: int, _: FrameType | None) -> None:
    stopped = KeyboardInterrupt() if number == signal.SIGINT else Terminated(number)
    _heard.append(stopped)
    raise stopped


def _raise_again(dropped: "sys.UnraisableHookArgs") -> None:
    stopped = dropped.exc_value
    if not isinstance(stopped, KeyboardInterrupt):
        sys.__unraisablehook__(dropped)
        return
    number = stopped.exit_code - 128 if isinstance(stopped, Terminated) else signal.SIGINT
    again = threading.Timer(AGAIN, os.kill, (os.getpid(), number))
    again.daemon = True
    again.start()


def stopped_by() -> KeyboardInterrupt | None:
    """The signal that stopped the program, if one did; some libraries make an error of it."""
    return _heard[0] if _heard else None


def leave(code: int) -> None:
    """Exit with a code, or `UNREAD`; a signal that comes later ends the process without a word."""
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    try:
        if sys.stdout is not None:  # None where it was closed from the start
            sys.stdout.flush()
    except BrokenPipeError:
        code = stop_printing()
    sys.exit(code)


def stop_printing() -> int:
    """Let standard output go nowhere, because nobody reads it any more; gives the exit code."""
    if sys.stdout is not None:
        # What is still to be flushed would make the interpreter complain at its end.
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, sys.stdout.fileno())
        os.close(nowhere)
    return UNREAD


def code_of(stopped: KeyboardInterrupt) -> int:
    """The exit code: 130 for Ctrl-C, 143 for SIGTERM, as shells count."""
    return stopped.exit_code if isinstance(stopped, Terminated) else INTERRUPTED


def reason_of(stopped: KeyboardInterrupt) -> str:
    """Why the program was stopped."""
    return str(stopped) or "interrupted"
