"""Damages files of every format and reads them: ``python -m tests.long.fuzz --cases 50000``.

Each format is tried in processes of its own, with 10 s for each file and 2 GB. What must not
happen: an exception that is no InputError (*foreign*), the death of the process (*aborts*), a file
that takes more than the limits (*over*),
a file that is read although it alone tells that it is damaged
(*silent*),
and one that is refused although it is sound (*lost*). The exit code is 1 if any of them did.
"""

import argparse
import json
import selectors
import subprocess
import sys
import time
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from tests.long.fuzz.formats import FORMATS, SECONDS, make_case

ROOT = Path(__file__).resolve().parents[3]
BAD = ("foreign", "abort", "over", "silent", "lost")


@dataclass
class Tally:
    """What came of the files of a format."""

    counts: Counter[str] = field(default_factory=Counter)
    slowest: float = 0.0
    seconds: float = 0.0
    failed: list[dict[str, Any]] = field(default_factory=list)

    def add(self, result: dict[str, Any]) -> None:
        self.counts[result["outcome"]] += 1
        self.slowest = max(self.slowest, result["seconds"])
        if result["outcome"] in BAD:
            self.failed.append(result)


def fuzz(name: str, seed: int, cases: int) -> Tally:
    """Try files of a format; a process that dies or hangs is replaced by a new one."""
    tally, start, begin = Tally(), 0, time.perf_counter()
    while start < cases:
        worker = subprocess.Popen(
            [
                sys.executable,
                "-m",
                "tests.long.fuzz.worker",
                name,
                str(seed),
                str(start),
                str(cases),
            ],
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            cwd=ROOT,
        )
        assert worker.stdout is not None
        with selectors.DefaultSelector() as selector:
            selector.register(worker.stdout, selectors.EVENT_READ)
            hung = False
            while True:
                # The first file also waits for the imports.
                if not selector.select(timeout=3 * SECONDS):
                    worker.kill()
                    hung = True
                    break
                line = worker.stdout.readline()
                if not line:
                    break
                tally.add(json.loads(line))
                start += 1
        worker.stdout.close()
        code = worker.wait()
        if start < cases:
            outcome = "over" if hung else "abort"
            what = make_case(name, seed, start).what
            said = f"exit code {code}"
            tally.add(
                {"outcome": outcome, "what": what, "said": said, "seconds": 0.0, "number": start}
            )
            start += 1
    tally.seconds = time.perf_counter() - begin
    return tally


def main() -> int:
    """Run, and print a table."""
    parser = argparse.ArgumentParser(prog="python -m tests.long.fuzz", description=__doc__)
    parser.add_argument("--cases", type=int, default=50_000, help="files in all")
    parser.add_argument("--seed", type=int, default=0, help="of what is drawn")
    parser.add_argument("--format", choices=FORMATS, action="append", help="only this one")
    parser.add_argument("--keep", type=Path, help="folder for the files that failed")
    given = parser.parse_args()
    names = given.format or list(FORMATS)
    shares = sum(FORMATS[name].share for name in names)
    row = "{:<11}{:>8}{:>9}{:>9}{:>9}{:>8}{:>6}{:>8}{:>6}{:>10}{:>9}"
    columns = (
        "cases",
        "refused",
        "accepted",
        "foreign",
        "aborts",
        "over",
        "silent",
        "lost",
        "slowest s",
        "all s",
    )
    sys.stdout.write(row.format("format", *columns) + "\n")
    total = Tally()
    for name in names:
        tally = fuzz(name, given.seed, max(1, round(given.cases * FORMATS[name].share / shares)))
        _print(row, name, tally)
        total.counts += tally.counts
        total.slowest, total.seconds = (
            max(total.slowest, tally.slowest),
            total.seconds + tally.seconds,
        )
        total.failed += [{"format": name, **one} for one in tally.failed]
    _print(row, "all", total)
    shown: Counter[tuple[str, str, str]] = Counter()
    for one in total.failed:
        kind = one["format"], one["outcome"], one["what"]
        shown[kind] += 1
        if shown[kind] <= 3:
            sys.stdout.write(
                f"{one['format']} {one['number']}: {one['outcome']} ({one['what']}) {one['said']}\n"
            )
        if given.keep is not None:
            given.keep.mkdir(parents=True, exist_ok=True)
            case = make_case(one["format"], given.seed, one["number"])
            ending = case.ending or FORMATS[one["format"]].ending
            (given.keep / f"{one['format']}-{one['number']}{ending}").write_bytes(case.content)
    return 1 if total.failed else 0


def _print(row: str, name: str, tally: Tally) -> None:
    counts = tally.counts
    numbers = [
        counts[one] for one in ("refused", "accepted", "foreign", "abort", "over", "silent", "lost")
    ]
    cells = (sum(counts.values()), *numbers, f"{tally.slowest:.2f}", f"{tally.seconds:.0f}")
    sys.stdout.write(row.format(name, *cells) + "\n")
    sys.stdout.flush()


if __name__ == "__main__":
    sys.exit(main())
