"""A bar on a terminal, and only there."""

from pathlib import Path

from tests.end_to_end.process import run_on_terminal


def test_a_terminal_sees_a_bar(traverse: Path, tmp_path: Path) -> None:
    out = tmp_path / "closures.json"
    code, seen = run_on_terminal("detect", traverse, "--out", out)
    assert code == 0
    assert "pairs" in seen
    assert "100 %" in seen
    assert out.exists()
