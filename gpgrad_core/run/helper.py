"""A second process that takes half of the work on a pair of submaps off this one.

It ends when its pipe closes, is killed when it falls silent for too long, because it was stopped or
hangs, and is started again after its death. The guide says why it is no pool (architecture.md).
"""

import contextlib
import logging
import os
import pickle
import queue
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Generator
from concurrent.futures import Future, wait
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import IO, Generic, Literal, TypeAlias, TypeVar, cast

from gpgrad_core.run import Cancelled, Progress, part, silent
from gpgrad_core.run.memory import give_back
from gpgrad_core.run.threads import at_most_workers, num_workers

_log = logging.getLogger(__name__)
R = TypeVar("R")
Result_co = TypeVar("Result_co", covariant=True)

LISTEN_EVERY = 0.02
"""Seconds between two progress reports while this process waits for the other."""
PIPE_BYTES = 1 << 20
"""Size of each pipe, where the system allows it; with 64 KiB, maps took twice as long to send."""
CLOSE_SECONDS = 2.0
"""Time that the process has to end by itself [s]."""
BEAT_EVERY = 0.5
"""Seconds between two signs of life of the other process."""
MOST_EARLY = 3
"""A process that is killed so often before it is ready is not started again."""
SILENCE = 5.0
"""The other process is killed when it has given no sign of life for so long [s]."""


@dataclass(frozen=True, eq=False)
class _Question:
    number: int
    function: Callable[..., object]  # of a module, with a keyword argument ``progress``
    arguments: tuple[object, ...]


@dataclass(frozen=True, eq=False)
class _Reply:
    number: int
    kind: Literal["alive", "fraction", "result", "error"]
    value: object


_Message: TypeAlias = _Question | int | None
"""A question, the number of one whose answer nobody wants any more, or to give back free memory."""


class HelperGone(Exception):
    """The other process has ended before it answered: the caller must do the work itself."""


class Answer(Generic[Result_co]):
    """The answer to a question that the helper is working on: `wait` for it, or `drop` it."""

    def __init__(self, drop: Callable[[], object]) -> None:
        self.drop = drop  # lets the other process stop at its next report
        self._fraction = 0.0
        self._result: Future[object] = Future()

    def on_reply(self, reply: _Reply | None) -> None:
        """Called with a reply; None means that there will be no more."""
        if reply is None:
            self._result.set_exception(HelperGone())
        elif reply.kind == "error":
            self._result.set_exception(cast("Exception", reply.value))
        elif reply.kind == "result":
            self._result.set_result(reply.value)
        else:
            self._fraction = cast("float", reply.value)

    def wait(self, progress: Progress = silent) -> Result_co:
        """Wait for the result, or raise what was raised there; HelperGone if the process ended."""
        try:
            while not self._result.done():
                progress(self._fraction)
                wait([self._result], LISTEN_EVERY)
            progress(self._fraction)
            return cast("Result_co", self._result.result())
        except BaseException:
            self.drop()
            raise


class Helper:
    """Runs one function at a time in another process while this one goes on.

    It never makes its caller wait: `ask` gives None while the process starts, which takes a second,
    or works on another question. A process that dies is started again, unless it ended by itself
    before it was ready, or was killed then again and again, which is logged.
    """

    def __init__(self) -> None:
        self._process = start_process()
        self._writing, self._lock = threading.Lock(), threading.Lock()
        self._count = 0
        self._current: Answer[object] | None = None
        self._free = False  # until the process says that it is ready
        self._closed = False
        self._num_replies = 0
        self._ended = threading.Event()
        threading.Thread(target=self._watch, name="helper-watch", daemon=True).start()
        self._listener = threading.Thread(target=self._listen, name="helper", daemon=True)
        self._listener.start()

    def ask(self, function: Callable[..., R], *arguments: object) -> Answer[R] | None:
        """Run ``function(*arguments, progress=…)`` of a module there; None if it is not free."""
        with self._lock:
            if not self._free:
                return None
            self._free = False
            self._count += 1
            # The process that was free: another one may take its place while this is sent.
            number, process = self._count, self._process
            answer: Answer[R] = Answer(lambda: self._send(process, number))
            self._current = answer
        if self._send(process, _Question(number, function, arguments)):
            return answer
        return None

    @property
    def process_id(self) -> int:
        return self._process.pid

    def give_back(self) -> bool:
        """Let the process return free memory to the system; False if the message was not sent."""
        with self._lock:
            process, is_there = self._process, self._free or self._current is not None
        return is_there and self._send(process, None)

    def restart(self) -> bool:
        """Replace the process, unless it is busy; says whether the old one has freed its memory."""
        with self._lock:
            if not self._free:
                return False
            self._free, process = False, self._process
        process.kill()  # the listener starts the next
        process.wait()
        return True

    def close(self) -> None:
        with self._lock:
            self._free, self._closed = False, True
            process = self._process
        with contextlib.suppress(OSError):
            _pipe(process.stdin).close()
        try:
            process.wait(CLOSE_SECONDS)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
        self._ended.set()
        self._listener.join()  # its pipe has ended
        _pipe(process.stdout).close()

    def _send(self, process: "subprocess.Popen[bytes]", message: _Message) -> bool:
        try:
            _write(_pipe(process.stdin), message, self._writing)
        except (OSError, ValueError):  # the pipe is broken, or closed
            return False
        return True

    def _watch(self) -> None:
        """Kill the process when it has fallen silent; the listener does the rest."""
        # Counted in rounds: after this process was stopped, or the machine slept, it begins anew.
        num_replies, silent_for = 0, 0.0
        while not self._ended.wait(BEAT_EVERY):
            with self._lock:
                was_ready = self._free or self._current is not None
                has_replied, num_replies = self._num_replies != num_replies, self._num_replies
                silent_for = 0.0 if has_replied or not was_ready else silent_for + BEAT_EVERY
                if silent_for > SILENCE:
                    self._process.kill()  # also ends a process that was stopped
                    silent_for = 0.0

    def _listen(self) -> None:
        early = 0
        while True:
            early = 0 if self._read_replies() else early + 1
            if (
                early
                and not self._closed
                and (early > MOST_EARLY or not _was_killed(self._process))
            ):
                _log.warning("the second process does not start; this one does its work, slower")
                break
            if not self._start_again():
                break
        _clean_up(self._process)

    def _read_replies(self) -> bool:
        """Pass on replies until the process ends; say whether it was ever ready."""
        replies, was_ready = _pipe(self._process.stdout), False
        while True:
            try:
                reply: _Reply | None = pickle.load(replies)
            except (EOFError, OSError, ValueError, pickle.UnpicklingError):
                reply = None
            with self._lock:
                answer = self._current
                self._num_replies += 1
                if reply is None or reply.kind in ("result", "error"):
                    self._current = None
                    self._free = reply is not None and not self._closed
            if answer is not None and (reply is None or reply.kind != "alive"):
                answer.on_reply(reply)
            if reply is None:
                return was_ready
            was_ready = True

    def _start_again(self) -> bool:
        """Replace a process that has died; say whether there is a new one."""
        with self._lock:
            if self._closed:
                return False
            died = self._process
            try:
                self._process = start_process()
            except OSError:
                return False
        _clean_up(died)
        return True


def _was_killed(process: "subprocess.Popen[bytes]") -> bool:
    """Whether a process that has closed its pipe was ended from outside."""
    try:
        return process.wait(CLOSE_SECONDS) < 0
    except subprocess.TimeoutExpired:
        return False


def _clean_up(died: "subprocess.Popen[bytes]") -> None:
    """Clean up after a process that has closed its pipe."""
    died.kill()  # it may still live
    died.wait()
    for pipe in (died.stdin, died.stdout):
        with contextlib.suppress(OSError):
            _pipe(pipe).close()


def start_process() -> "subprocess.Popen[bytes]":
    """Start the other process, which runs `main`."""
    path = os.pathsep.join(entry for entry in sys.path if entry)
    # Before they are loaded: threads of BLAS that have worked spin for many milliseconds more, on
    # the processor that the first process needs.
    single = dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"), "1")

    def start(pipe_bytes: int) -> "subprocess.Popen[bytes]":
        return subprocess.Popen(
            [sys.executable, "-c", "from gpgrad_core.run.helper import main; main()"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            pipesize=pipe_bytes,
            env={**os.environ, **single, "PYTHONPATH": path},
        )

    with _interrupts_blocked():
        try:
            return start(PIPE_BYTES)
        except PermissionError:  # a user may have so much in pipes, and no more
            return start(-1)


@contextlib.contextmanager
def _interrupts_blocked() -> Generator[None]:
    """Let a process that starts in the block ignore Ctrl-C from its first moment."""
    if not hasattr(signal, "pthread_sigmask"):  # Windows
        yield
        return
    # It inherits the signals that this thread blocks; a second of loading would end in a traceback.
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def start_helper() -> Helper | None:
    """Start a helper; None if there is only one processor, or the system cannot start a process."""
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
    """Call a function here and in the helper at once, each with half of the processors."""
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
    assert pipe is not None  # the process was started with pipes
    return pipe


def _write(pipe: IO[bytes], message: object, lock: threading.Lock) -> None:
    packed = pickle.dumps(message, protocol=5)
    with lock:
        pipe.write(packed)
        pipe.flush()


def _serve(questions: IO[bytes], replies: IO[bytes]) -> None:
    """Answer questions until the pipe closes."""
    waiting: queue.SimpleQueue[_Question | None] = queue.SimpleQueue()
    lock = threading.Lock()
    stopped = 0  # highest number of a question whose answer is no longer wanted

    def read() -> None:
        nonlocal stopped
        while True:
            try:
                message: _Message = pickle.load(questions)
            except (EOFError, OSError, ValueError):
                stopped = sys.maxsize
                waiting.put(None)
                return
            if isinstance(message, int):
                stopped = max(stopped, message)
            elif message is None:
                give_back()
            else:
                waiting.put(message)

    def beat() -> None:
        with contextlib.suppress(OSError, ValueError):  # the end is noticed elsewhere
            while True:
                time.sleep(BEAT_EVERY)
                _write(replies, _Reply(0, "alive", None), lock)

    _write(replies, _Reply(0, "result", None), lock)  # says that it is ready
    for endless in (read, beat):
        threading.Thread(target=endless, daemon=True).start()
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
    """Run as the other process."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the first process
    replies = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # printed text must not mix with the replies
    with contextlib.suppress(BrokenPipeError):
        _serve(sys.stdin.buffer, replies)
