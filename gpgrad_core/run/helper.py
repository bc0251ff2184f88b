"""A second process that works beside this one, for what two threads would be no faster at.

The stages of a submap are thousands of small NumPy calls; threads of one process mostly wait for
each other with these. Two submaps in two processes were measured 1.9 times as fast as in one.
A process of its own, not `multiprocessing`: that runs the caller's main module once more.
"""

import contextlib
import os
import pickle
import queue
import signal
import subprocess
import sys
import threading
from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import IO, Any, Generic, Literal, TypeVar

from gpgrad_core.run.progress import Cancelled, Progress, part, silent
from gpgrad_core.run.threads import at_most_workers, num_workers

R = TypeVar("R")

LISTEN_EVERY = 0.02
"""Seconds between two reports while the other process is waited for."""
CLOSE_SECONDS = 2.0
"""What the process may take to end by itself [s]."""


@dataclass(frozen=True, eq=False)
class _Question:
    number: int
    function: Callable[..., Any]  # of a module, with a keyword ``progress``
    arguments: tuple[Any, ...]


@dataclass(frozen=True, eq=False)
class _Reply:
    number: int
    kind: Literal["fraction", "result", "error"]
    value: Any


class HelperGone(Exception):
    """The other process has ended: what was asked of it is to be done here."""


class Answer(Generic[R]):
    """What the helper was asked; `wait` for it, or `drop` it."""

    def __init__(self, stop: Callable[[], object]) -> None:
        """Await the replies to a question.

        Args:
            stop: Tells the other process that nobody waits any more.
        """
        self._stop = stop
        self._replies: queue.SimpleQueue[_Reply | None] = queue.SimpleQueue()

    def hear(self, reply: _Reply | None) -> None:
        """Take a reply; None: there will be no more."""
        self._replies.put(reply)

    def drop(self) -> None:
        """Let the other process stop at its next report."""
        self._stop()

    def wait(self, progress: Progress = silent) -> R:
        """Wait for the result.

        Args:
            progress: Called now and then; if it raises, the other process stops too.

        Raises:
            HelperGone: If the other process has ended.
            Exception: What the function raised there.
        """
        fraction = 0.0
        try:
            while True:
                progress(fraction)
                try:
                    reply = self._replies.get(timeout=LISTEN_EVERY)
                except queue.Empty:
                    continue
                if reply is None:
                    raise HelperGone
                if reply.kind == "fraction":
                    fraction = float(reply.value)
                elif reply.kind == "error":
                    raise reply.value
                else:
                    return reply.value
        except BaseException:
            self.drop()
            raise


class Helper:
    """Runs one function at a time in another process while this one goes on.

    It is a convenience only: while it starts, which takes a second, while it is busy with
    another's question, and when it has died, `ask` gives None, and the work is done here.
    """

    def __init__(self) -> None:
        """Start the process; returns at once.

        Raises:
            OSError: If the system lets none start.
        """
        path = os.pathsep.join(entry for entry in sys.path if entry)
        self._process = subprocess.Popen(
            [sys.executable, "-c", "from gpgrad_core.run.helper import main; main()"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            env={**os.environ, "PYTHONPATH": path},
        )
        self._writing, self._lock = threading.Lock(), threading.Lock()
        self._count = 0
        self._current: Answer[Any] | None = None
        self._free = False  # not before it says that it has loaded all
        self._listener = threading.Thread(target=self._listen, name="helper", daemon=True)
        self._listener.start()

    def ask(self, function: Callable[..., R], *arguments: object) -> Answer[R] | None:
        """Let the other process begin on ``function(*arguments, progress=…)``.

        Args:
            function: Of a module, for its name goes to the other process.
            arguments: Picklable.

        Returns:
            What to wait for; None if it is to be done here.
        """
        with self._lock:
            if not self._free:
                return None
            self._free = False
            self._count += 1
            number = self._count
            answer: Answer[R] = Answer(lambda: self._send(number))
            self._current = answer
        if self._send(_Question(number, function, arguments)):
            return answer
        return None

    def close(self) -> None:
        """End the process."""
        with self._lock:
            self._free = False
        with contextlib.suppress(OSError):
            _pipe(self._process.stdin).close()
        try:
            self._process.wait(CLOSE_SECONDS)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._listener.join()  # what it listens to has ended
        _pipe(self._process.stdout).close()

    def _send(self, message: _Question | int) -> bool:
        """Ask, or, by a question's number, stop; says whether there is anyone to hear it."""
        pipe = _pipe(self._process.stdin)
        try:
            _write(pipe, message, self._writing)
        except (OSError, ValueError):  # broken, or closed
            return False
        return True

    def _listen(self) -> None:
        replies = _pipe(self._process.stdout)
        while True:
            try:
                reply: _Reply | None = pickle.load(replies)
            except (EOFError, OSError, ValueError, pickle.UnpicklingError):
                reply = None
            with self._lock:
                answer = self._current
                if reply is None or reply.kind != "fraction":
                    self._current, self._free = None, reply is not None
            if answer is not None:
                answer.hear(reply)
            if reply is None:
                return


def start_helper() -> Helper | None:
    """Start a helper, if there is a processor for it and the system lets a process start."""
    if num_workers() < 2:
        return None
    with contextlib.suppress(OSError):
        return Helper()
    return None


def beside(
    helper: Helper | None,
    function: Callable[..., R],
    here: tuple[object, ...],
    there: tuple[object, ...],
    progress: Progress = silent,
) -> tuple[R, R]:
    """Call a function with two lots of arguments: one here, one in the helper if it is free.

    Each has half of the processors then.

    Args:
        helper: None: both are done here, one after the other.
        function: Of a module, with a keyword ``progress``.
        here: Arguments of the first call.
        there: Arguments of the second call; picklable.
        progress: Called with the fraction done; may raise Cancelled.
    """
    first_half, second_half = part(progress, 0.0, 0.5), part(progress, 0.5, 1.0)
    answer = None if helper is None else helper.ask(function, *there)
    if answer is None:
        return function(*here, progress=first_half), function(*there, progress=second_half)
    try:
        with _half_of_the_processors():
            first = function(*here, progress=first_half)
    except BaseException:
        answer.drop()
        raise
    try:
        return first, answer.wait(second_half)
    except HelperGone:
        return first, function(*there, progress=second_half)


def _half_of_the_processors() -> AbstractContextManager[None]:
    return at_most_workers(max(1, num_workers() // 2))


def _pipe(pipe: IO[bytes] | None) -> IO[bytes]:
    assert pipe is not None  # all of them were asked for
    return pipe


def _write(pipe: IO[bytes], message: object, lock: threading.Lock) -> None:
    packed = pickle.dumps(message, protocol=5)
    with lock:
        pipe.write(packed)
        pipe.flush()


def _serve(questions: IO[bytes], replies: IO[bytes]) -> None:
    """Answer questions until there are no more to come."""
    waiting: queue.SimpleQueue[_Question | None] = queue.SimpleQueue()
    lock = threading.Lock()
    stopped = 0  # highest number of a question that is no longer wanted

    def read() -> None:
        nonlocal stopped
        while True:
            try:
                message: _Question | int = pickle.load(questions)
            except (EOFError, OSError, ValueError):
                stopped = sys.maxsize
                waiting.put(None)
                return
            if isinstance(message, int):
                stopped = max(stopped, message)
            else:
                waiting.put(message)

    threading.Thread(target=read, daemon=True).start()
    _write(replies, _Reply(0, "result", None), lock)  # all is loaded
    while (question := waiting.get()) is not None:
        number = question.number

        def report(fraction: float, number: int = number) -> None:
            if stopped >= number:
                raise Cancelled
            _write(replies, _Reply(number, "fraction", fraction), lock)

        try:
            with _half_of_the_processors():
                result = question.function(*question.arguments, progress=report)
            reply = _Reply(number, "result", result)
        except Exception as error:
            reply = _Reply(number, "error", error)
        _write(replies, reply, lock)


def main() -> None:
    """Be the other process."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the first process's to heed
    replies = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # whatever prints must not come between
    with contextlib.suppress(BrokenPipeError):
        _serve(sys.stdin.buffer, replies)
