"""What --json prints."""

import json
from pathlib import Path
from typing import Any

import pytest

from app.cli import FAILED, INTERRUPTED, VERBS, run
from app.cli.terminal import EVENTS, conclude, exit_code, progress_bar, say, warn

FIELDS = {
    "started": {"verb", "gpgrad"},
    "progress": {"stage", "fraction"},
    "info": {"text"},
    "warning": {"text"},
    "closure": {
        *("query", "database", "method", "score", "num_inliers", "overlap_area", "reason"),
        *("T_database_query", "z_offset"),
    },
    "result": {"text", "output", "values"},
    "error": {"exit_code", "text"},
}
"""The promise: the fields of each event."""


def told(out: str) -> list[dict[str, Any]]:
    """Read events, and check each against the promise."""
    events = [json.loads(line) for line in out.splitlines()]
    for event in events:
        assert set(event) == FIELDS[event["event"]] | {"event"}
        assert next(iter(event)) == "event"
    return events


def test_what_is_said_becomes_events(capsys: pytest.CaptureFixture[str]) -> None:
    with EVENTS.on(True):
        say("a line", "another")
        warn("left out")
        conclude("done", output=Path("x.json"), error=float("nan"), pairs=3)
    captured = capsys.readouterr()
    assert captured.err == "gpgrad: left out\n"
    assert told(captured.out) == [
        {"event": "info", "text": "a line"},
        {"event": "info", "text": "another"},
        {"event": "warning", "text": "left out"},
        {
            "event": "result",
            "text": ["done"],
            "output": "x.json",
            "values": {"error": None, "pairs": 3},
        },
    ]


def test_without_the_flag_there_are_none(capsys: pytest.CaptureFixture[str]) -> None:
    say("a line")
    conclude("done", pairs=3)
    with progress_bar("pairs") as progress:
        progress(0.5)
    assert capsys.readouterr().out == "a line\ndone\n"


def test_progress_is_told_seldom_and_to_its_end(capsys: pytest.CaptureFixture[str]) -> None:
    with EVENTS.on(True), progress_bar("pairs") as progress:
        for k in range(10_000):
            progress(k / 10_000)
    events = told(capsys.readouterr().out)
    assert 2 <= len(events) < 20
    assert (events[0]["fraction"], events[-1]["fraction"]) == (0.0, 1.0)


def test_progress_never_goes_back(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("app.cli.terminal.BETWEEN", 0.0)
    with EVENTS.on(True), progress_bar("fit") as progress:
        for fraction in (0.1, 0.3, 0.2, 0.3, 1.0, 1.0):
            progress(fraction)
    assert [event["fraction"] for event in told(capsys.readouterr().out)] == [0.1, 0.3, 1.0]


@pytest.mark.parametrize("verb", VERBS)
def test_every_verb_tells_wrong_usage(verb: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert run([verb, "--json", "--bogus"]) == FAILED
    captured = capsys.readouterr()
    events = told(captured.out)
    assert events[0]["event"] == "started"
    assert events[0]["verb"] == verb
    assert events[-1]["event"] == "error"
    assert events[-1]["exit_code"] == FAILED
    assert "--bogus" in events[-1]["text"] or "missing" in events[-1]["text"].lower()
    assert captured.err == f"gpgrad: {events[-1]['text']}\n"


def test_an_interruption_is_told(capsys: pytest.CaptureFixture[str]) -> None:
    def work() -> None:
        raise KeyboardInterrupt

    with EVENTS.on(True):
        assert exit_code(work) == INTERRUPTED
    (event,) = told(capsys.readouterr().out)
    assert event == {"event": "error", "exit_code": INTERRUPTED, "text": "interrupted"}


def test_the_guide_lists_every_event_with_its_fields() -> None:
    guide = Path(__file__).resolve().parents[3] / "assets" / "guide" / "commands.md"
    text = guide.read_text(encoding="utf-8")
    for event, fields in FIELDS.items():
        (row,) = [line for line in text.splitlines() if line.startswith(f"| `{event}` |")]
        for field in fields:
            assert f"`{field}`" in row, (event, field)
