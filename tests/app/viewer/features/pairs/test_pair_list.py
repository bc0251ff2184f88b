import numpy as np
import viser

from app.viewer.features.pairs.pose_graph import MOST_LISTED, PairList
from gpgrad_core.types import LoopClosure, Registration
from tests.support.widgets import find, user_sets

NOTHING = Registration(None, np.zeros(0, bool), np.inf, 0.0, 0.0, 0.0)
PAIRS = [
    (LoopClosure(f"q{number}", "d", NOTHING, False, ""), "seen")
    for number in range(MOST_LISTED + 5)
]


def test_a_long_list_is_cut_and_counted(server: viser.ViserServer) -> None:
    chosen: list[tuple[str, str] | None] = []
    pairs = PairList(server, "Loop", none="none", hint="", on_choose=chosen.append)
    pairs.offer(PAIRS, ("q1", "d"))
    handle = find(server, "Loop")
    assert handle.options[0] == f"none (the first {MOST_LISTED} of {len(PAIRS)})"
    assert len(handle.options) == MOST_LISTED + 1
    assert (handle.value, pairs.chosen) == ("q1 → d · 0.00 · seen", ("q1", "d"))
    assert chosen == []  # nobody chose it
    for step in ("previous", "previous", None, "next"):  # round the end, to none, to the first
        user_sets(find(server, "Step loop") if step else handle, step or handle.options[0])
    last = MOST_LISTED - 1
    assert chosen == [("q0", "d"), (f"q{last}", "d"), None, ("q0", "d")]
    pairs.offer([], None)
    user_sets(find(server, "Step loop"), "next")
    assert pairs.chosen is None
    assert len(chosen) == 4
