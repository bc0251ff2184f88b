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

ROOT = Path(__file__).resolve().parents[3]
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
        """Start it with a budget of memory, and wait until it serves."""
        self.name = name
        self.samples: list[Sample] = []
        self.log = folder / f"{name}.log"
        self._begin = time.monotonic()
        with self.log.open("w") as log:
            self.process = subprocess.Popen(
                [
                    *(sys.executable, "-m", "app", "view", "--no-open", "--port", "0"),
                    *("--memory", memory, "--config", str(folder / name)),
                    *("--cache", str(folder / f"{name} cache"), *flags),
                ],
                stdout=subprocess.PIPE,
                stderr=log,
                text=True,
                cwd=ROOT,
            )
        assert self.process.stdout is not None
        links = (re.search(r"http://\S+", line) for line in self.process.stdout)
        self.url = next(match[0] for match in links if match)
        self._ended = threading.Event()
        self._watcher = threading.Thread(target=self._watch, daemon=True)
        self._watcher.start()

    def stop_watching(self) -> None:
        """Take no more samples."""
        self._ended.set()
        self._watcher.join()

    def memory(self) -> float:
        """Measure what the viewer and its helper take now [MB]."""
        return self._sample(psutil.Process(self.process.pid)).memory

    def end(self) -> int:
        """End it; gives the exit code."""
        self.process.terminate()
        assert self.process.stdout is not None
        self.process.stdout.close()
        return self.process.wait(60)

    def around(self, share: float, width: float = 0.1) -> dict[str, float]:
        """Give the medians of what it took in the part of the time that ends at a share of it."""
        last = self.samples[-1].seconds
        part = [
            sample
            for sample in self.samples
            if (share - width) * last < sample.seconds <= share * last
        ]
        names = ("memory", "viewer", "helper", "swap", "threads", "descriptors")
        return {
            name: float(np.median([getattr(sample, name) for sample in part])) for name in names
        }

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
            sum(process.memory_info().rss for process in children) / 1e6,
            sum(_swap(process.pid) for process in both) / 1e6,
            sum(process.num_threads() for process in both),
            sum(process.num_fds() for process in both),
        )


def _swap(process: int) -> float:
    with suppress(OSError):
        swap = re.search(r"VmSwap:\s+(\d+)", Path(f"/proc/{process}/status").read_text())
        return 1024.0 * int(swap[1]) if swap else 0.0
    return 0.0
