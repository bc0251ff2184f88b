"""Kills ``gpgrad`` at random moments, and looks at what is left."""

import json
import math
import os
import random
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from gpgrad_core.io.folder import write_dataset
from gpgrad_core.run.folders import private_folder
from gpgrad_core.simulation.params import SimulationParams
from gpgrad_core.simulation.recording import simulate_recording
from gpgrad_core.simulation.simulate import simulate_dataset
from tests.core.recordings.test_build import contents
from tests.end_to_end.process import environment, start

SMALL = SimulationParams(
    num_submaps=10,
    spacing=2.0,
    extent=24.0,
    max_range=4.0,
    voxel_size=0.1,
    max_points=1500,
    rock_density=0.2,
    crater_density=0.02,
)
SMALL_FLAGS = (
    *("--num-submaps", "10", "--spacing", "2", "--extent", "24", "--max-range", "4"),
    *("--voxel-size", "0.1", "--max-points", "1500"),
    *("--rock-density", "0.2", "--crater-density", "0.02"),
)
SCANS = 80
KILLS = {"INT": signal.SIGINT, "TERM": signal.SIGTERM, "KILL": getattr(signal, "SIGKILL", 9)}
CODES = {"INT": (130, -2), "TERM": (143, -15), "KILL": (-9,)}
"""How a process ends by each signal; the second is for one that comes after all work is done."""
SAID = {"INT": "gpgrad: interrupted", "TERM": "gpgrad: terminated"}
PATIENCE = 120.0
"""Longest time that a process may take to end [s]; the machine may be busy."""
ORPHANS_END = 30.0
"""Longest time that its children may take to end after it [s]; some may only just begin to load."""


@dataclass(frozen=True)
class Verb:
    """A command that is killed.

    Attributes:
        name: In the table.
        arguments: What follows ``gpgrad``; ``{out}`` is the folder of the outputs.
        output: Name of its output in that folder; empty if it has none.
        exact: Whether a second run writes the same bytes.
        resumes: Name of what a stopped run may leave to be resumed.
    """

    name: str
    arguments: tuple[str, ...]
    output: str = ""
    exact: bool = False
    resumes: str = ""


VERBS = (
    Verb("simulate", ("simulate", "{out}/data", *SMALL_FLAGS), "data", exact=True),
    Verb(
        "simulate --scans",
        ("simulate", "{out}/drive", "--scans", str(SCANS), *SMALL_FLAGS),
        "drive",
        exact=True,
    ),
    Verb(
        "build",
        ("build", "{recording}", "--out", "{out}/built", "--max-length", "2"),
        "built",
        exact=True,
        resumes="built.partial",
    ),
    Verb("detect", ("detect", "{dataset}", "--out", "{out}/closures.json"), "closures.json"),
    Verb("evaluate", ("evaluate", "{dataset}", "--out", "{out}/report"), "report"),
    Verb(
        "reproduce",
        ("reproduce", "{dataset}", "--out", "{out}/figures", "--method", "paper"),
        "figures",
        exact=True,
    ),
    Verb("slam", ("slam", "{dataset}", "--out", "{out}/map"), "map"),
    Verb("map", ("map", "{dataset}/submaps/000.ply", "--out", "{out}/map.npz"), "map.npz"),
    Verb("fit", ("fit", "{dataset}", "--out", "{out}/fitted.toml"), "fitted.toml"),
    Verb("view", ("view", "{dataset}", "--no-open", "--port", "0", "--config", "{out}")),
)


@dataclass
class Outcome:
    """What a kill left: a file that is "whole", "nothing", "to resume", or "left" for the next run.

    It came so many seconds after the program had begun; each fault is a line.
    """

    verb: str
    kill: str
    seconds: float
    state: str = "nothing"
    faults: list[str] = field(default_factory=list[str])


class Stage:
    """A tiny dataset, a tiny recording, and for each verb what it writes when nobody kills it."""

    def __init__(self, root: Path) -> None:
        """Make the dataset and the recording in an empty folder, in which all processes work."""
        self.root = root
        self.dataset, self.recording = root / "dataset", root / "recording"
        write_dataset(simulate_dataset(SMALL), self.dataset)
        simulate_recording(self.recording, SCANS, SMALL)
        self._inputs = contents(self.dataset) | contents(self.recording)
        self._whole: dict[str, dict[str, str]] = {}
        self._seconds: dict[str, float] = {}

    def inputs_changed(self) -> bool:
        """Tell whether the dataset or the recording is no longer what it was."""
        return self._inputs != contents(self.dataset) | contents(self.recording)

    def kill(self, verb: Verb, kill: str, share: float) -> Outcome:
        """Run a verb, kill it after a share of the time that it takes, and look at what it left."""
        self._learn(verb)
        outcome = Outcome(verb.name, kill, share * self._seconds[verb.name])
        with self._sandbox() as box:
            process = self._start(verb, box, stderr=subprocess.PIPE, start_new_session=True)
            wait_until_heard(process)
            time.sleep(outcome.seconds)
            if kill == "INT":  # a terminal sends it to all of its processes
                os.killpg(process.pid, KILLS[kill])
            else:
                process.send_signal(KILLS[kill])
            try:
                _, said = process.communicate(timeout=PATIENCE)
            except subprocess.TimeoutExpired:
                outcome.faults.append(f"was still there after {PATIENCE:g} s")
                os.killpg(process.pid, signal.SIGKILL)
                _, said = process.communicate()
            outcome.faults += _end(kill, process.returncode, said)
            outcome.faults += _orphans(process.pid)
            self._judge(verb, box, outcome)
        return outcome

    def _learn(self, verb: Verb) -> None:
        """Run a verb to its end, once."""
        if verb.name in self._whole:
            return
        with self._sandbox() as box:
            self._seconds[verb.name] = self._run(verb, box)
            self._whole[verb.name] = contents(box / "out")

    def _run(self, verb: Verb, box: Path) -> float:
        """Run a verb; give the time that it took after the program had begun [s]."""
        process = self._start(verb, box, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
        wait_until_heard(process)
        begun = time.monotonic()
        if verb.name == "view":  # it does not end by itself
            assert process.stdout is not None
            next((line for line in process.stdout if "http" in line), "")
            process.terminate()
        _, said = process.communicate(timeout=PATIENCE)
        if process.returncode != (143 if verb.name == "view" else 0):
            raise RuntimeError(f"{verb.name} ended with {process.returncode}: {said}")
        return time.monotonic() - begun

    def _start(self, verb: Verb, box: Path, **options: object) -> "subprocess.Popen[str]":
        places = {"out": box / "out", "dataset": self.dataset, "recording": self.recording}
        arguments = (argument.format(**places) for argument in verb.arguments)
        return start(*arguments, env=environment() | {"TMPDIR": str(box / "tmp")}, **options)

    @contextmanager
    def _sandbox(self) -> Iterator[Path]:
        box = self.root / "box"
        for name in ("out", "tmp"):
            (box / name).mkdir(parents=True)
        try:
            yield box
        finally:
            shutil.rmtree(box)

    def _judge(self, verb: Verb, box: Path, outcome: Outcome) -> None:
        """Say in what state the files are, and whether the next run sets right what is not."""
        out = box / "out"
        if verb.output and (out / verb.output).exists():
            outcome.state = "whole"
            outcome.faults += self._half(verb, out)
        left = _names(verb, box)
        if verb.resumes in left:
            outcome.state = "to resume"
        elif left:
            outcome.state = "left"
        if outcome.kill != "KILL" and [name for name in left if name != verb.resumes]:
            outcome.faults.append(f"left {', '.join(left)}")
        if left and not outcome.faults:
            time.sleep(2.5)  # what was made just now counts as another's
            self._run(verb, box)
            if still := _names(verb, box):
                outcome.faults.append(f"the next run left {', '.join(still)}")
            outcome.faults += self._half(verb, out)

    def _half(self, verb: Verb, out: Path) -> list[str]:
        """Say in what an output differs from the one of a run that nobody killed."""
        whole = self._whole[verb.name]
        made = {
            name: digest
            for name, digest in contents(out).items()
            if not any(part.startswith(".") for part in Path(name).parts)
            and Path(name).parts[0] == verb.output
        }
        if made.keys() != whole.keys():
            return [f"half an output: {sorted(made.keys() ^ whole.keys())[:5]}"]
        if verb.exact and made != whole:
            return ["an output with another content"]
        try:
            READERS.get(Path(verb.output).suffix, lambda _: None)(out / verb.output)
        except (ValueError, OSError, KeyError, AssertionError) as error:
            return [f"an output that cannot be read: {error}"]
        return []


def _names(verb: Verb, box: Path) -> list[str]:
    """Name what lies among the outputs and the temporary files beside the output itself."""
    paths = (*(box / "out").iterdir(), *private_folder(box / "tmp").iterdir())
    return [path.name for path in paths if path.name != verb.output]


def _pairs(path: Path) -> None:
    assert len(json.loads(path.read_text())["pairs"]) == math.comb(SMALL.num_submaps, 2)


def _layers(path: Path) -> None:
    with np.load(path) as layers:
        assert np.isfinite(layers["elevation"]).all()


READERS: dict[str, Callable[[Path], None]] = {".json": _pairs, ".npz": _layers}


def _end(kill: str, code: int, said: str) -> list[str]:
    """Say what is wrong with the way in which a process ended."""
    faults = [] if code in (*CODES[kill], 0) else [f"exit code {code}: {said[-300:]!r}"]
    if kill == "KILL":
        return faults
    if "Traceback" in said or "Exception ignored" in said:
        faults.append(f"more than a line: {said[-2000:]}")
    if code == CODES[kill][0] and not said.splitlines()[-1].startswith(SAID[kill]):
        faults.append(f"the last line is {said.splitlines()[-1]!r}")
    return faults


def wait_until_heard(process: "subprocess.Popen[str]") -> None:
    """Wait until a process has said how it wants to be ended; before, Python alone is at work."""
    status, bit = Path(f"/proc/{process.pid}/status"), 1 << (signal.SIGTERM - 1)
    while process.poll() is None:
        lines = status.read_text().splitlines()
        caught = next((line for line in lines if line.startswith("SigCgt:")), "SigCgt: 0")
        if int(caught.split()[1], 16) & bit:
            return
        time.sleep(0.005)


def running(session: int) -> list[str]:
    """List the processes of a session that still run, with their commands."""
    processes: list[str] = []
    for folder in Path("/proc").iterdir():
        if not folder.name.isdigit():
            continue
        try:
            _, _, rest = (folder / "stat").read_text().rpartition(")")
            state, _, _, of_session, *_ = rest.split()
            command = (folder / "cmdline").read_bytes().replace(b"\0", b" ").decode()
        except OSError:  # it has ended
            continue
        if int(of_session) == session and state not in "ZX":
            processes.append(f"{folder.name} {command[:80]}")
    return processes


def _orphans(session: int) -> list[str]:
    """Wait for a killed process's children to end; end and name those that do not."""
    deadline = time.monotonic() + ORPHANS_END
    while (left := running(session)) and time.monotonic() < deadline:
        time.sleep(0.05)
    for process in left:
        os.kill(int(process.split()[0]), signal.SIGKILL)
    return [f"an orphan: {process}" for process in left]


def kill_at_random(
    stage: Stage, kills: int, seed: int, tell: Callable[[Outcome], None]
) -> list[Outcome]:
    """Kill every verb in turn by every signal, at random moments; tell of each."""
    rng = random.Random(seed)
    outcomes: list[Outcome] = []
    for k in range(kills):
        verb = VERBS[k % len(VERBS)]
        kill = rng.choice(list(KILLS))
        outcomes.append(stage.kill(verb, kill, rng.uniform(0.0, 1.0)))
        tell(outcomes[-1])
    return outcomes


def table(outcomes: list[Outcome]) -> str:
    """Count the outcomes, in a row for each verb."""
    states = ("nothing", "whole", "to resume", "left")
    rows = [("verb", *KILLS, *states, "faults")]
    for name in dict.fromkeys(outcome.verb for outcome in outcomes):
        of_verb = [outcome for outcome in outcomes if outcome.verb == name]
        rows.append(
            (
                name,
                *(str(sum(outcome.kill == kill for outcome in of_verb)) for kill in KILLS),
                *(str(sum(outcome.state == state for outcome in of_verb)) for state in states),
                str(sum(bool(outcome.faults) for outcome in of_verb)),
            )
        )
    total = [sum(int(row[k]) for row in rows[1:]) for k in range(1, len(rows[0]))]
    rows.append(("all", *map(str, total)))
    widths = [max(len(row[k]) for row in rows) for k in range(len(rows[0]))]
    return "\n".join(
        "  ".join(
            cell.ljust(width) if k == 0 else cell.rjust(width)
            for k, (cell, width) in enumerate(zip(row, widths, strict=True))
        )
        for row in rows
    )


def can_kill() -> bool:
    """Tell whether this system shows what processes do and leaves them to themselves."""
    return sys.platform == "linux"
