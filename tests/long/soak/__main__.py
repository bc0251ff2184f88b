"""Uses viewers for long, as eight people do: ``python -m tests.long.soak --minutes 60``.

Two viewers run, each a process with its helper: one session that all pages share, and separate
sessions that come and go with their pages. People drag sliders, change pairs and layers, upload,
save and restore, let long work begin and cancel it, leave and come back. Memory, threads and
descriptors are sampled all the time. Now and then all rest, sliders are dragged on one page, and
after quiet every page must show what a fresh viewer shows. The exit code is 1 unless memory at a
quarter, at the half and at the end of the time lies within 10 %, threads and descriptors within
10 %, no picture was stale, and nobody was thrown out.
"""

import argparse
import random
import sys
import tempfile
import threading
import time
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from playwright.sync_api import Browser
from playwright.sync_api import Error as BrowserError

from tests.browser.chromium import find_chromium, launch
from tests.long.soak.pages import Person, make_files
from tests.long.soak.stale import ask_and_compare
from tests.long.soak.watch import Served

WITHIN = 10.0
"""Per cent."""
STAY, AWAY = 20.0, 160.0
"""How long a real browser looks, and how long it stays away [s]."""
MEASURED = ("memory", "threads", "descriptors")


@dataclass
class Report:
    """What came of it.

    Attributes:
        minutes: How long it took.
        viewers: With their samples.
        stale: What was not what had been asked for last.
        errors: What else went wrong.
        num_checks: How often all pages were compared with a fresh viewer.
        num_acts: What people did.
        num_visits: How many pages were opened.
        num_looks: How often a real browser looked.
        answers: How long the viewers took to answer [s].
    """

    minutes: float
    viewers: list[Served] = field(default_factory=list)
    stale: list[str] = field(default_factory=list)
    errors: list[str] = field(default_factory=list)
    num_checks: int = 0
    num_acts: int = 0
    num_visits: int = 0
    num_looks: int = 0
    answers: list[float] = field(default_factory=list)

    @property
    def is_good(self) -> bool:
        """Whether memory, threads and descriptors are flat, and nothing was stale or failed."""
        spreads = [viewer.spread(name) for viewer in self.viewers for name in MEASURED]
        return max(spreads) <= WITHIN and not self.stale and not self.errors

    def text(self) -> str:
        """Write it for people."""
        shares = (0.25, 0.5, 1.0)
        moments = [f"{self.minutes * share:g} min" for share in shares]
        lines = [
            f"{self.num_acts:,} acts on {self.num_visits:,} pages, {self.num_looks} visits of a "
            f"real browser; {self.num_checks} times all "
            f"pages were compared with a fresh viewer: {len(self.stale)} stale",
            f"answers of the viewers: median {1000 * np.median(self.answers):.0f} ms, 99 % within "
            f"{np.quantile(self.answers, 0.99):.1f} s, slowest {max(self.answers):.1f} s",
        ]
        for viewer in self.viewers:
            peak = max(sample.memory for sample in viewer.samples)
            lines.append(f"{viewer.name}: most memory at any moment {peak:,.0f} MB")
            for name in ("memory", "viewer", "helper", "swap", "threads", "descriptors"):
                values = [viewer.around(share)[name] for share in shares]
                shown = ", ".join(
                    f"{value:,.0f} at {when}" for value, when in zip(values, moments, strict=True)
                )
                spread = f"; spread {viewer.spread(name):.1f} %" if name in MEASURED else ""
                lines.append(f"  {name:<12} {shown}{spread}")
        return "\n".join([*lines, *self.stale, *self.errors])


class Onlooker:
    """A real browser that opens the shared session now and then, and looks at it.

    It does not stay, because it draws without a graphics card, which takes half of a processor.
    """

    def __init__(self, url: str) -> None:
        """Begin; `end` closes it. Does nothing where there is no Chromium."""
        self.errors: list[str] = []
        self.num_visits = 0
        self._url = url
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._live, daemon=True)
        self._thread.start()

    def end(self) -> None:
        """Close it."""
        self._ended.set()
        self._thread.join()

    def _live(self) -> None:
        executable = find_chromium()
        while executable is not None and not self._ended.is_set():
            try:
                with launch(executable) as browser:
                    self._look(browser)
            except (AssertionError, BrowserError) as error:
                self.errors.append(f"browser: {error}")
            self._ended.wait(AWAY)

    def _look(self, browser: Browser) -> None:
        # So wide that the submaps stand side by side, as in the fresh viewer of the comparisons.
        page = browser.new_page(viewport={"width": 1700, "height": 900})
        page.on("pageerror", lambda error: self.errors.append(f"browser: {error}"))
        page.goto(f"{self._url}/?fixedDpr=1", timeout=120_000)
        # In Explore and Demo the card is there too, but hidden.
        page.get_by_test_id("status").first.wait_for(state="attached", timeout=120_000)
        end = time.monotonic() + STAY
        while time.monotonic() < end and not self._ended.is_set():
            page.wait_for_timeout(500)
        self.num_visits += 1
        page.close()


def soak(
    minutes: float,
    seed: int = 0,
    pages: int = 8,
    *,
    memory: str = "1GB",
    browser: bool = True,
    every: float = 60.0,
) -> Report:
    """Use viewers for a time; of separate sessions there are half as many pages."""
    report, rng = Report(minutes), random.Random(seed)
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="soak-")))
        files = make_files(folder)
        shared = Served("shared session", memory, folder)
        stack.callback(shared.process.kill)
        separate = Served("separate sessions", memory, folder, "--sessions", "separate")
        stack.callback(separate.process.kill)
        report.viewers = [shared, separate]
        end = time.monotonic() + 60 * minutes
        people = [Person(shared.url, rng.getrandbits(32), files, 300.0) for _ in range(pages)]
        others = [Person(separate.url, rng.getrandbits(32), files, 30.0) for _ in range(pages // 2)]
        onlooker = Onlooker(shared.url) if browser else None
        while (left := end - time.monotonic()) > 0:
            time.sleep(min(every, left))
            if left > every:
                compare(people, rng, report)
        for viewer in report.viewers:
            viewer.stop_watching()
        for person in (*people, *others):
            person.end()
            report.num_acts += person.num_acts
            report.num_visits += person.num_visits
            report.answers += person.answers
            report.errors += person.errors
        if onlooker is not None:
            onlooker.end()
            report.errors += onlooker.errors
            report.num_looks = onlooker.num_visits
        for viewer in report.viewers:
            code = viewer.end()
            said = viewer.log.read_text().splitlines()
            if code != 143 or said != ["gpgrad: terminated"]:
                report.errors.append(f"{viewer.name}: exit code {code}: {said[-5:]}")
    return report


def compare(people: Sequence[Person], rng: random.Random, report: Report) -> None:
    """Let all rest, and look whether a picture is stale."""
    for person in people:
        person.rest()
    try:
        there = [person.page for person in people if person.page is not None]
        stale = ask_and_compare(there, rng)
        report.num_checks += 1
        print(  # noqa: T201
            f"{time.strftime('%H:%M:%S')} comparison {report.num_checks}: {len(stale)} stale",
            file=sys.stderr,
            flush=True,
        )
        report.stale += stale
        for line in stale:
            print(f"stale: {line}", file=sys.stderr, flush=True)  # noqa: T201
    except AssertionError as error:
        report.errors.append(f"comparing: {error}")
    finally:
        for person in people:
            person.go_on()


def draw(report: Report, path: Path) -> None:
    """Draw memory, threads and descriptors over the time."""
    import matplotlib as mpl  # noqa: PLC0415

    mpl.use("agg")
    from matplotlib import pyplot as plt  # noqa: PLC0415

    figure, axes = plt.subplots(2, 1, figsize=(9, 5), sharex=True, layout="constrained")
    for viewer in report.viewers:
        minutes = [sample.seconds / 60 for sample in viewer.samples]
        axes[0].plot(minutes, [sample.memory for sample in viewer.samples], label=viewer.name)
        for name, style in (("threads", "-"), ("descriptors", "--")):
            values = [getattr(sample, name) for sample in viewer.samples]
            axes[1].plot(minutes, values, style, label=f"{name}, {viewer.name}")
    axes[0].set_ylabel("memory [MB]")
    axes[1].set_ylabel("number")
    axes[1].set_xlabel("time [min]")
    for axis in axes:
        axis.set_ylim(bottom=0)
        axis.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), fontsize="small")
        axis.grid(alpha=0.3)
    figure.savefig(path, dpi=110)
    plt.close(figure)


def main() -> None:
    """Run the command."""
    parser = argparse.ArgumentParser(prog="python -m tests.long.soak", description=__doc__)
    parser.add_argument("--minutes", type=float, default=60.0)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--pages", type=int, default=8)
    parser.add_argument("--memory", default="1GB", help="budget of each viewer")
    parser.add_argument("--no-browser", action="store_true", help="open no real browser")
    parser.add_argument("--every", type=float, default=60.0, help="seconds between comparisons")
    parser.add_argument("--plot", type=Path, help="write a figure")
    given = parser.parse_args()
    report = soak(
        given.minutes,
        given.seed,
        given.pages,
        memory=given.memory,
        browser=not given.no_browser,
        every=given.every,
    )
    print(report.text(), flush=True)  # noqa: T201
    if given.plot is not None:
        draw(report, given.plot)
    sys.exit(0 if report.is_good else 1)


if __name__ == "__main__":
    main()
