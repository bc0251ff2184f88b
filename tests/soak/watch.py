"""A viewer in a process of its own, and what it takes of the machine."""

import re
import subprocess
import sys
import threading
import time
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import psutil

ROOT = Path(__file__).resolve().parents[2]
EVERY = 2.0
"""Seconds between two samples."""


@dataclass(frozen=True)
class Sample:
    """What the viewer and its helper take at one moment.

    Attributes:
        seconds: Since the start.
        viewer: Resident memory [MB].
        helper: That of all processes that the viewer has started [MB].
        swap: Of both, on disk [MB].
        threads: Of both.
        descriptors: Open files and sockets of both.
    """

    seconds: float
    viewer: float
    helper: float
    swap: float
    threads: int
    descriptors: int

    @property
    def memory(self) -> float:
        """Of both, on disk or not [MB]."""
        return self.viewer + self.helper + self.swap


class Served:
    """``gpgrad view`` in a process; sampled until it ends."""

    def __init__(self, name: str, memory: str, folder: Path, *flags: str) -> None:
        """Start it and wait until it serves.

        Args:
            name: What figures call it.
            memory: Its budget, for ``--memory``.
            folder: For its settings and its log.
            flags: Of the command.
        """
        self.name = name
        self.samples: list[Sample] = []
        self.log = folder / f"{name}.log"
        self._begin = time.monotonic()
        with self.log.open("w") as log:
            self.process = subprocess.Popen(
                [
                    *(sys.executable, "-m", "app", "view", "--no-open", "--port", "0"),
                    *("--memory", memory, "--config", str(folder / name), *flags),
                ],
                stdout=subprocess.PIPE,
                stderr=log,
                text=True,
                cwd=ROOT,
            )
        assert self.process.stdout is not None
        found = (re.search(r"http://\S+", line) for line in self.process.stdout)
        self.url = next(match[0] for match in found if match)
        self._ended = threading.Event()
        self._watcher = threading.Thread(target=self._watch, daemon=True)
        self._watcher.start()

    def stop_watching(self) -> None:
        """Take no more samples."""
        self._ended.set()
        self._watcher.join()

    def end(self) -> int:
        """End it; gives the exit code."""
        self.process.terminate()
        assert self.process.stdout is not None
        self.process.stdout.close()
        return self.process.wait(60)

    def around(self, share: float, width: float = 0.1) -> dict[str, float]:
        """Give the medians of what it took around a moment.

        Args:
            share: Of the whole time, at which the part ends.
            width: Of the whole time.
        """
        last = self.samples[-1].seconds
        part = [one for one in self.samples if (share - width) * last < one.seconds <= share * last]
        names = ("memory", "viewer", "helper", "swap", "threads", "descriptors")
        return {name: float(np.median([getattr(one, name) for one in part])) for name in names}

    def spread(self, name: str) -> float:
        """Say by how many per cent a quarter, the half and the end differ."""
        values = [self.around(share)[name] for share in (0.25, 0.5, 1.0)]
        return 100 * (max(values) - min(values)) / min(values)

    def _watch(self) -> None:
        process = psutil.Process(self.process.pid)
        while not self._ended.wait(EVERY):
            with suppress(psutil.Error):  # a process ended meanwhile
                self.samples.append(self._sample(process))

    def _sample(self, process: psutil.Process) -> Sample:
        children = process.children(recursive=True)
        both = [process, *children]
        return Sample(
            time.monotonic() - self._begin,
            process.memory_info().rss / 1e6,
            sum(one.memory_info().rss for one in children) / 1e6,
            sum(_swap(one.pid) for one in both) / 1e6,
            sum(one.num_threads() for one in both),
            sum(one.num_fds() for one in both),
        )


def _swap(process: int) -> float:
    with suppress(OSError):
        found = re.search(r"VmSwap:\s+(\d+)", Path(f"/proc/{process}/status").read_text())
        return 1024.0 * int(found[1]) if found else 0.0
    return 0.0
