"""One budget of memory for the viewer and its helper together, measured and bounded.

What is counted is what the two processes hold of the machine's memory, not what the memo counts
as its own: beside its arrays there are the dataset, the scene, uploads, and memory that is free but
not released.
"""

import contextlib
import os
import re
import threading
import time
from collections.abc import Callable
from pathlib import Path

import psutil

from gpgrad_core.errors import InputError
from gpgrad_core.run.helper import Helper
from gpgrad_core.run.memo import Memo
from gpgrad_core.run.memory import give_back, trim

LEAST = 600_000_000
"""Bytes; viewer and helper have 460 MB with the demo open before anything is remembered."""
SHARE = 0.25
"""Of the machine's memory that the two take by default, from `LEAST` to `MOST`."""
MOST = 8_000_000_000
UNFINISHED_SHARE = 0.25
"""Of the budget for what pages have begun to send and not ended."""
MEMO_SHARE = 0.5
"""Of the budget for the memo's arrays: its bound between two measurements."""
RELIEVE_ABOVE = 0.88
"""Share of the budget from which memory is released. Work goes on between two measurements, and
meanwhile: with fifty pages that all drag, the two processes take up to an eighth of 800 MB more
within a fifth of a second, when a picture waits to be sent to each."""
RELIEVED = 0.8
"""Relief goes down to this share of the budget, so that it is not needed again at once."""
TRIMMED = 0.85
"""If memory that is free already brings the processes down to this share, relief ends there."""
GROWN = 0.03
"""If relief leaves more than that, it is tried again when so much of the budget has been added: it
takes some tenths of a second, and drops results that are needed again."""
HELPER_SHARE = 0.35
"""A helper that holds more of the budget is replaced; it begins with 150 MB."""
MEASURE_EVERY = 0.2
"""Seconds between two measurements."""
PAUSE = 8.0
"""Seconds between two attempts beyond the budget while nothing is added."""
FULL_AFTER = 60.0
"""The budget cannot be met when that was so for so long [s]: work that is done passes it too."""
GOING = 0.2
"""Time in which the helper gives memory back [s]."""

_SIZE = re.compile(r"(\d{1,6}(?:\.\d{1,6})?) ?([MGT])B", re.ASCII | re.IGNORECASE)
_UNITS = {"M": 1e6, "G": 1e9, "T": 1e12}


def read_size(text: str) -> int:
    """Read a budget, which must be enough to work with.

    >>> read_size("800MB"), read_size("1.5 GB")
    (800000000, 1500000000)
    """
    parts = _SIZE.fullmatch(text.strip())
    if parts is None:
        raise InputError(f"--memory {text}: must be a size such as 800MB or 4GB")
    size = round(float(parts[1]) * _UNITS[parts[2].upper()])
    if size < LEAST:
        raise InputError(f"--memory {text}: the viewer needs {shown(LEAST)} or more")
    return size


def shown(size: float) -> str:
    """Write a size for people.

    >>> shown(812_345_678), shown(4_000_000_000)
    ('812 MB', '4.0 GB')
    """
    return f"{size / 1e9:.1f} GB" if size >= 1e9 else f"{size / 1e6:.0f} MB"


def default_budget() -> int:
    """The budget by default: a share of what this process may have at all."""
    total = min([psutil.virtual_memory().total, *group_limits()])
    return round(min(max(SHARE * total, LEAST), MOST))


def resident(process: int) -> int:
    """Measure what a process holds of the machine's memory [bytes]; 0 if it has ended."""
    try:
        return int(psutil.Process(process).memory_info().rss)
    except psutil.Error:
        return 0


class MemoryKeeper:
    """Measures now and then, and gives memory back before the budget is passed.

    First goes what is free already, in this process and then in both. Then the helper, if it alone
    holds too much, is replaced by a fresh one. Then the memo drops results, the least recently used
    first.
    """

    def __init__(
        self,
        budget: int,
        memo: Memo,
        helper: Helper | None,
        on_full: Callable[[str], None] | None = None,
        of_pages: Callable[[], int] = lambda: 0,
        *,
        held_by: Callable[[int], int] = resident,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """Begin to measure; `close` ends it.

        ``on_full`` is called once, with a sentence, when the budget cannot be met.
        ``of_pages`` returns the bytes of what pages have begun to send and not ended, ``held_by``
        those of a process.
        """
        self.budget = budget  # bytes for both processes together
        self._of_pages, self._held_by, self._clock = of_pages, held_by, clock
        self._memo, self._helper, self._on_full = memo, helper, on_full
        self._closed = threading.Event()
        self._thread = threading.Thread(target=self._watch, name="memory", daemon=True)
        self._thread.start()

    def close(self) -> None:
        self._closed.set()
        self._thread.join()

    def measure(self) -> int:
        return self._held_by(os.getpid()) + self._of_helper()

    def relieve(self) -> int:
        """Release memory until the budget is met, as far as possible; measures after [bytes]."""
        trim()  # mostly enough, while work goes on, and the only step that holds up nobody
        if (held := self.measure()) <= TRIMMED * self.budget:
            return held
        target = RELIEVED * self.budget
        if self._helper is not None and self._helper.give_back():
            self._closed.wait(GOING)
        give_back()
        if self._helper is not None and self._of_helper() > HELPER_SHARE * self.budget:
            self._helper.restart()
        while (held := self.measure()) > target and self._memo.num_bytes:
            self._memo.drop_to(max(0, round(self._memo.num_bytes - (held - target))))
            trim()
        return held

    def _watch(self) -> None:
        tried, full_since = -PAUSE, None
        left = 0  # after the last relief, or less if less was held since [bytes]
        while not self._closed.wait(MEASURE_EVERY):
            held, now = self.measure(), self._clock()
            left = min(left, held)
            has_grown = held > max(RELIEVE_ABOVE * self.budget, left + GROWN * self.budget)
            if has_grown or (held > self.budget and now - tried >= PAUSE):
                left, tried = self.relieve(), now
                held = left
            if held <= self.budget:
                full_since = None
                continue
            full_since = full_since or now
            if now - full_since > FULL_AFTER and self._on_full is not None:
                self._on_full(
                    f"viewer and helper hold {shown(held)} and can give nothing back: "
                    f"{self._cause(held)} --memory {shown(self.budget)}"
                )
                self._on_full = None

    def _cause(self, held: int) -> str:
        of_pages = self._of_pages()
        if held - of_pages > self.budget:
            return "this dataset needs more than"
        return (
            f"with {shown(of_pages)} that pages have begun to send and not ended, that is more than"
        )

    def _of_helper(self) -> int:
        return 0 if self._helper is None else self._held_by(self._helper.process_id)


def group_limits(
    groups: Path = Path("/sys/fs/cgroup"), own: Path = Path("/proc/self/cgroup")
) -> list[int]:
    """Read the limits of this process's control groups [bytes], which containers have."""
    limits: list[int] = []
    with contextlib.suppress(OSError):
        for line in own.read_text().splitlines():
            _, controllers, path = line.split(":", 2)
            if controllers and "memory" not in controllers.split(","):
                continue
            name = "memory.limit_in_bytes" if controllers else "memory.max"
            root = groups / "memory" if controllers else groups
            inner = root / path.lstrip("/")
            for folder in (inner, *inner.parents):
                with contextlib.suppress(OSError, ValueError):  # "max" is no number
                    limits.append(int((folder / name).read_text()))
                if folder == root:
                    break
    return limits
