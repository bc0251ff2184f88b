import threading
from collections.abc import Iterator, Mapping
from pathlib import Path

import pytest
import viser

from app.viewer.features.pairs.model import PHASES
from app.viewer.features.work import Downloads, Work, safe_name
from app.viewer.session.jobs import Jobs, Slots
from app.viewer.widgets.status import WHOLE, TimeLeft, WorkBar
from gpgrad_core.errors import InputError
from gpgrad_core.run import Progress
from tests.support.page import FakePage
from tests.support.phases import MISLEADS, misled
from tests.support.widgets import find, user_presses


class Task:
    """Work by hand: half done until it is let go."""

    def __init__(self) -> None:
        self.go = threading.Event()
        self.begun = threading.Event()
        self.error: Exception | None = None

    def __call__(self, job: str, progress: Progress) -> str:
        while not self.go.wait(0.005):
            progress(0.5)
            self.begun.set()
        if self.error is not None:
            raise self.error
        return job.upper()


@pytest.fixture
def bar(server: viser.ViserServer) -> WorkBar:
    return WorkBar(server, "Cancel it", "task", starts=(server.gui.add_button("Start it"),))


@pytest.fixture
def task() -> Task:
    return Task()


Told = list[tuple[float | None, str]]


@pytest.fixture
def told() -> Told:
    return []


@pytest.fixture
def work(bar: WorkBar, task: Task, told: Told) -> Iterator[Work[str, str]]:
    jobs = Jobs()
    made: Work[str, str] = Work(
        jobs,
        bar,
        lambda job: f"Doing {job}" if job else "",
        task,
        lambda job, result, _: bar.done(f"{job}: {result}"),
        watch=lambda fraction, message: told.append((fraction, message)),
    )
    yield made
    task.go.set()
    jobs.close()


def test_the_bar_shows_what_runs_and_what_came_of_it(
    server: viser.ViserServer, bar: WorkBar, task: Task, told: Told, work: Work[str, str]
) -> None:
    work.start("one")
    assert task.begun.wait(120)
    assert "Doing one … 50 %" in bar.said
    assert find(server, "Cancel it").visible
    assert not find(server, "Start it").visible
    task.go.set()
    assert work.wait_idle(120)
    assert "one: ONE" in bar.said
    assert not find(server, "Cancel it").visible
    assert find(server, "Start it").visible
    assert told == [(0.0, ""), (0.5, ""), (None, "")]


def test_work_is_cancelled_by_its_button(
    server: viser.ViserServer, bar: WorkBar, task: Task, told: Told, work: Work[str, str]
) -> None:
    work.start("one")
    assert task.begun.wait(120)
    user_presses(find(server, "Cancel it"))
    assert work.wait_idle(120)
    assert "Cancelled." in bar.said
    assert told[-1] == (None, "Cancelled.")


def test_a_failure_is_escaped(bar: WorkBar, task: Task, told: Told, work: Work[str, str]) -> None:
    task.error = InputError("<b>: no such file")
    task.go.set()
    work.start("one")
    assert work.wait_idle(120)
    assert "&lt;b&gt;: no such file" in bar.said
    assert told[-1] == (None, "<b>: no such file")


def told_times(
    paces: list[tuple[float, float]], phases: Mapping[str, float] = WHOLE
) -> list[tuple[float, float | None]]:
    """Give what is told, and how long it truly takes, for work of these shares and seconds."""
    left, now, fraction, told = TimeLeft(), 0.0, 0.0, list[tuple[float, float | None]]()
    total = sum(seconds for _, seconds in paces)
    for share, seconds in paces:
        for _ in range(round(100 * share)):
            told.append((total - now, left.at(fraction, now, phases)[1]))
            now, fraction = now + seconds / (100 * share), fraction + 0.01
    return told


def test_the_time_left_of_even_work_is_told_soon_and_right() -> None:
    told = told_times([(1.0, 50.0)])
    assert all(said is None for true, said in told if true > 48.1)
    assert all(said == pytest.approx(true) for true, said in told if true < 47.9)


@pytest.mark.parametrize("phases", [WHOLE, {"maps": 0.6, "pairs": 1.0}])
def test_no_time_left_is_told_from_the_pace_of_other_work(phases: Mapping[str, float]) -> None:
    # The first stages are quick, because what they make was kept; their pace promised 5 seconds.
    told = told_times([(0.6, 4.0), (0.4, 240.0)], phases)
    late = [(true, said) for true, said in told if said is not None and true < 240.0]
    assert len(late) > 25
    assert all(0.65 < said / true < 1.5 for true, said in late)
    if phases is not WHOLE:
        assert all(said is None for true, said in told if 235.0 < true <= 240.0)
        assert all(said < 3.0 for true, said in told if true > 240.0 and said is not None)


def test_each_phase_of_a_recorded_run_is_told_right() -> None:
    # Seconds of the phases of all pairs of 29 submaps, measured on a machine with two processors.
    seconds = (1.5, 0.0, 17.0, 0.1, 59.1)
    starts = (0.0, *PHASES.values())
    now, record = 0.0, [(0.0, 0.0)]
    for start, end, took in zip(starts, PHASES.values(), seconds, strict=False):
        done = [step / 100 for step in range(1, 101)]
        record += [(now + took * part, start + (end - start) * part) for part in done]
        now += took
    ratios = misled(record)
    assert len(ratios) > 40  # most of the steps of maps and pairs, though their paces differ
    assert all(abs(ratio - 1) <= MISLEADS for ratio in ratios)


def test_a_quick_job_shows_no_bar(
    server: viser.ViserServer, task: Task, told: Told, work: Work[str, str]
) -> None:
    work.start("")
    assert task.begun.wait(120)
    assert not find(server, "Cancel it").visible
    task.go.set()
    assert work.wait_idle(120)
    assert told == [(None, "")]


def test_a_file_is_made_and_sent_to_the_page_that_asked(bar: WorkBar) -> None:
    page, other = FakePage(), FakePage()
    downloads = Downloads(Jobs(), bar, Slots(1))

    def write(path: Path, progress: Progress) -> None:
        progress(0.5)
        path.write_text("high")

    downloads.order(page, "hills.txt", write)
    assert downloads.wait_idle(120)
    assert page.files == {"hills.txt": b"high"}
    assert other.files == {}
    assert "hills.txt: 4 bytes" in bar.said
    assert safe_name("../my hills", "file") == "my_hills"
