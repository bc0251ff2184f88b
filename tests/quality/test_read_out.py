"""How soon what is under the cursor is read out, on an idle machine.

The window is small: a processor that draws a large one takes longer for one picture than all else
together, and no page shows anything while it draws.

Run by hand: ``pytest tests/quality/test_read_out.py -n 0 -s``; half a minute.
"""

import numpy as np
import pytest

from app.viewer.viewer import Viewer
from gpgrad_core.io.folder import load_dataset
from gpgrad_core.simulation.demo import demo_path
from tests.browser.chromium import find_chromium, launch
from tests.browser.test_canvas import GIVEN, open_page

pytestmark = pytest.mark.browser

WATCH = """() => {
    window.asked = []; window.read = [];
    const [say, marks] = [gpgrad.say, gpgrad.acts.marks];
    gpgrad.say = (name, data, newest) => {
        if (name === 'cursor') window.asked.push([performance.now(), data.x]);
        return say.call(gpgrad, name, data, newest);
    };
    gpgrad.acts.marks = data => {
        marks(data);
        if (data.at !== undefined) window.read.push([performance.now(), data.at]);
    };
}"""
"""Notes when the page asks what is under its cursor, and when it shows the answer [ms]."""
READ_OUT_MS = 100.0
SIZE = 900, 500


def test_the_read_out_follows_the_cursor_within_a_tenth_of_a_second() -> None:
    executable = find_chromium()
    if executable is None:
        pytest.skip("no Chromium was found")
    viewer = Viewer(load_dataset(demo_path()), GIVEN, port=0, source=str(demo_path()))
    try:
        with launch(executable) as browser:
            page = open_page(browser, viewer, SIZE, "#query=007&database=001")
            canvas = page.get_by_test_id("over-canvas").bounding_box()
            page.evaluate(WATCH)
            for step in range(30):
                page.mouse.move(
                    canvas["x"] + (0.25 + 0.003 * step) * canvas["width"],
                    canvas["y"] + (0.5 + 0.002 * step) * canvas["height"],
                )
                page.wait_for_timeout(180)  # each comes to rest, so that its answer is awaited
            asked, read = page.evaluate("[window.asked, window.read]")
    finally:
        viewer.close()
    shown = {place: moment for moment, place in read}
    waits = [shown[place] - moment for moment, place in asked if place in shown]
    print(f"read out after {np.median(waits):.0f} ms, at most {max(waits):.0f} ms")
    assert len(waits) >= 10, waits
    assert np.median(waits) <= READ_OUT_MS, waits
