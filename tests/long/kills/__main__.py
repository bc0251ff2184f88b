"""Kills every verb at random moments: ``python -m tests.long.kills --kills 100 --seed 0``.

Prints a table, and ends with 1 if a process was left, an output was half, or anything else was left
than what the next run resumes or removes.
"""

import argparse
import sys
import tempfile
from pathlib import Path

from tests.long.kills.killing import Outcome, Stage, can_kill, kill_at_random, table


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.long.kills")
    parser.add_argument("--kills", type=int, default=100)
    parser.add_argument("--seed", type=int, default=0, help="of the moments (default: 0)")
    asked = parser.parse_args()
    if not can_kill():
        _say("this needs Linux: it looks at processes in /proc")
        return 2
    with tempfile.TemporaryDirectory(prefix="kills-") as folder:
        stage = Stage(Path(folder))
        outcomes = kill_at_random(stage, asked.kills, asked.seed, _tell)
        changed = stage.inputs_changed()
    _say(table(outcomes))
    _say("nothing: no output and no leftover; left: the next run removed it")
    if changed:
        _say("an input was changed")
    return int(changed or any(outcome.faults for outcome in outcomes))


def _tell(outcome: Outcome) -> None:
    for fault in outcome.faults:
        _say(f"{outcome.verb}, {outcome.kill} after {outcome.seconds:.2f} s: {fault}")


def _say(text: str) -> None:
    sys.stdout.write(f"{text}\n")
    sys.stdout.flush()


if __name__ == "__main__":
    sys.exit(main())
