"""Are faults that are put in by hand found by the tests? Run before a change of the tests lands.

It takes the files of git revisions, never the working tree. In each it puts in the faults of
`faults.toml`, one after the other, and runs the tests named there until one fails, which must pass
without a fault. Two revisions stand side by side:

    python -m tests.long.mutations --tree main~1 --tree main

What CI finds beyond the default run is asked for with GPGRAD_THOROUGH=1 and -m "slow or not slow".
"""

import argparse
import os
import re
import subprocess
import sys
import tarfile
import tempfile
import time
import tomllib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from fnmatch import fnmatch
from functools import partial
from io import BytesIO
from pathlib import Path

ROOT = Path(__file__).resolve().parents[3]
NOT_FOUND = "NOT FOUND"
PASSED, FAILED = (0, 5), (1, 2)
"""Exit codes of pytest: all passed, or none was there; some failed, or could not be collected."""
LONGEST = 600.0
"""Time after which tests that go on count as stopped by the fault [s]."""


@dataclass(frozen=True)
class Fault:
    """A text that is once in a file, what replaces it, and the tests that should notice."""

    name: str
    file: str
    old: str
    new: str
    tests: tuple[str, ...]

    def changed(self, tree: Path) -> str:
        """Give the file's text with the fault in it."""
        text = (tree / self.file).read_text(encoding="utf-8")
        if (count := text.count(self.old)) != 1:
            raise SystemExit(f"{self.name}: {self.file} has its text {count} times, not once")
        return text.replace(self.old, self.new)

    @contextmanager
    def put_into(self, tree: Path) -> Iterator[None]:
        """Put the fault in for the time of a ``with`` block."""
        file, whole, changed = tree / self.file, (tree / self.file).read_bytes(), self.changed(tree)
        file.write_text(changed, encoding="utf-8")
        try:
            yield
        finally:
            file.write_bytes(whole)


def read_faults(patterns: Sequence[str]) -> list[Fault]:
    """Read the faults whose names match a pattern."""
    rows = tomllib.loads(Path(__file__).with_name("faults.toml").read_text(encoding="utf-8"))
    faults = [Fault(**{**row, "tests": tuple(row["tests"])}) for row in rows["fault"]]
    return [one for one in faults if any(fnmatch(one.name, pattern) for pattern in patterns)]


def unpack(revision: str, folder: Path) -> Path:
    """Write the files of a revision into a folder."""
    command = ["git", "-C", str(ROOT), "archive", revision]
    archive = subprocess.run(command, capture_output=True, check=True).stdout
    with tarfile.open(fileobj=BytesIO(archive)) as files:
        files.extractall(folder, filter="data")
    return folder


def failures(tree: Path, tests: Sequence[str], *options: str) -> list[str]:
    """Run tests; gives the names of those that fail."""
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", *options, *tests]
    environment = {**os.environ, "PYTHONPATH": str(tree)}
    environment.pop("PYTHONDONTWRITEBYTECODE", None)  # all would be compiled anew for each fault
    try:
        done = subprocess.run(
            command,
            capture_output=True,
            text=True,
            cwd=tree,
            env=environment,
            timeout=LONGEST,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return [f"no end within {LONGEST:g} s"]
    failed = re.findall(r"^(?:FAILED|ERROR) (.+?)(?: - |$)", done.stdout, re.MULTILINE)
    if done.returncode not in PASSED and (done.returncode not in FAILED or not failed):
        raise SystemExit(f"{' '.join(command)}:\n{done.stdout[-3000:]}{done.stderr[-3000:]}")
    return failed


def found_by(fault: Fault, tree: Path, marker: Sequence[str], *, whole: bool) -> str:
    """Say which test finds a fault first, of those named, or else of all if they are asked for."""
    tests = [path for path in fault.tests if (tree / path).exists()]
    with fault.put_into(tree):
        failed = failures(tree, tests, "-x", "-n", "0", *marker) if tests else []
        if not failed and whole:
            failed = failures(tree, [], "-x", *marker)
    return failed[0] if failed else NOT_FOUND


def main() -> None:
    """Put in the faults, print who found them, and fail if one was not found."""
    parser = argparse.ArgumentParser(prog="python -m tests.long.mutations", description=__doc__)
    parser.add_argument("names", nargs="*", default=["*"], help="patterns of the faults' names")
    parser.add_argument("--tree", action="append", help="revision (default: HEAD); may be repeated")
    parser.add_argument("-m", "--marker", help="tests by their marks, as pytest takes it")
    parser.add_argument("--whole", action="store_true", help="then all, if these find none")
    asked = parser.parse_args()
    names: list[str] = asked.tree or ["HEAD"]
    faults, marker = read_faults(asked.names), ["-m", asked.marker] if asked.marker else []
    say = partial(print, flush=True)
    with tempfile.TemporaryDirectory(prefix="mutations-") as folder:
        trees = [unpack(name, Path(folder, str(k))) for k, name in enumerate(names)]
        for tree in trees:
            for fault in faults:
                fault.changed(tree)  # which refuses one that does not fit, before the long work
        say(" | ".join(["fault", *(f"{name} | s" for name in names)]))
        found: list[list[str]] = [[] for _ in trees]
        for fault in faults:
            cells: list[str] = [fault.name]
            for tree, tests in zip(trees, found, strict=True):
                start = time.monotonic()
                tests.append(found_by(fault, tree, marker, whole=asked.whole))
                cells += [tests[-1], f"{time.monotonic() - start:.0f}"]
            say(" | ".join(cells))
        unsound: list[str] = []
        for tree, tests in zip(trees, found, strict=True):
            named = sorted({test for test in tests if (tree / test.partition("::")[0]).exists()})
            unsound += failures(tree, named, "-n", "0", *marker) if named else []
    for test in unsound:
        say(f"fails without a fault too: {test}")
    say(f"not found: {found[-1].count(NOT_FOUND)} of {len(faults)}")
    sys.exit(1 if unsound or NOT_FOUND in found[-1] else 0)


if __name__ == "__main__":
    main()
