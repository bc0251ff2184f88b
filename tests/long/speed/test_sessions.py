"""Separate sessions come and go, hundreds of them: nothing of them stays; minutes."""

import os
import threading
import time
from contextlib import suppress

import psutil
import pytest

from app.viewer.viewer import Viewer
from gpgrad_core.detection import PipelineParams
from gpgrad_core.io.folder import load_dataset
from gpgrad_core.mapping.gradient_map import MapParams
from gpgrad_core.run.memory import give_back
from gpgrad_core.simulation.demo import demo_path
from tests.support.page import ProtocolPage

SESSIONS = int(os.environ.get("GPGRAD_SESSIONS", "500"))
AT_ONCE = 4
QUICK = PipelineParams(map=MapParams(max_points=1000, resolution=0.2))


def floor_of(viewer: Viewer) -> tuple[float, int, int]:
    """Measure memory [MB], threads and descriptors, without pages."""
    end = time.monotonic() + 30
    while viewer.sessions:
        assert time.monotonic() < end, "sessions whose pages have gone do not end"
        time.sleep(0.05)
    time.sleep(2.0)  # the last of their work ends
    give_back()
    process = psutil.Process()
    return process.memory_info().rss / 1e6, threading.active_count(), process.num_fds()


@pytest.mark.filterwarnings("ignore:Queued a")  # pages leave while their pictures are drawn
def test_500_separate_sessions_come_and_go() -> None:
    viewer = Viewer(load_dataset(demo_path()), QUICK, port=0, sessions="separate")
    seen: list[tuple[float, int, int]] = []
    try:
        for number in range(SESSIONS // AT_ONCE):
            pages = [ProtocolPage(viewer.url) for _ in range(AT_ONCE)]
            for k, page in enumerate(pages):
                page.wait(lambda page=page: "Up to date" in page.html(), "a picture", timeout=60)
                page.set("Length-scale", 0.2 + 0.1 * k)
            for page in pages:
                with suppress(OSError):
                    page.close()
            if (number + 1) % max(1, SESSIONS // AT_ONCE // 5) == 0:
                seen.append(floor_of(viewer))
                print(f"{AT_ONCE * (number + 1)} sessions: {seen[-1]}")
    finally:
        viewer.close()
    first, last = seen[0], seen[-1]
    assert last[0] <= 1.1 * first[0]
    assert last[1] <= first[1] + 2
    assert last[2] <= first[2] + 2
