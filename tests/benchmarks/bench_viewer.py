"""How fast the picture follows a slider: ``python -m tests.benchmarks.bench_viewer``.

Two submaps of 5,000 points at 0.05 m/pixel, real mouse events in a real browser. Printed are
medians, in milliseconds, of

- server: from the parameters to the messages, without a browser;
- GPU machine: from the mouse event to the new vertices in the graphics memory and the draw call
  that uses them, with the drawing of large calls left out, for a machine with a graphics card
  does that in a few milliseconds;
- software: the same until the software renderer has finished the picture.

Minimum inliers changes the picture only where the verdict turns, so for it the verdict card counts.
"""

import statistics
import sys
import time
from dataclasses import dataclass
from typing import Any

from app.panels.params import with_path
from app.server import MAIN_PARAMETERS, Viewer
from gpgrad_core.datasets import demo_path, load_dataset
from gpgrad_core.gradient_map import MapParams
from gpgrad_core.memo import Memo
from gpgrad_core.pipeline import PipelineParams, register_pair
from tests.browser.chromium import ViewerPage, find_chromium, launch

PARAMS = PipelineParams(map=MapParams(max_points=5000, resolution=0.05))
TARGETS_MS = {
    "features.max_std_ratio": 150,
    "registration.inlier_radius": 150,
    "closure.min_inliers": 150,
    "map.length_scale": 700,
    "map.noise_std": 700,
}
VALUES = {
    "features.max_std_ratio": [0.20, 0.22, 0.24, 0.26, 0.28, 0.32, 0.34, 0.36],
    "registration.inlier_radius": [0.14, 0.16, 0.18, 0.2, 0.22, 0.24, 0.26, 0.32],
    "closure.min_inliers": [3, 4, 5, 6, 7, 9, 10, 11],
    "map.length_scale": [0.26, 0.27, 0.28, 0.29, 0.31, 0.32, 0.33, 0.34],
    "map.noise_std": [0.02, 0.025, 0.03, 0.035, 0.04, 0.06, 0.065, 0.07],
}
STRIDES = {
    "features.max_std_ratio": -3,
    "registration.inlier_radius": -4,
    "closure.min_inliers": 8,
    "map.length_scale": 3,
    "map.noise_std": 3,
}
"""How far one event moves the thumb [pixels]."""
EVENTS = 8

# Watches the page: input events, uploads of vertices, and when a draw call after them is done.
# Large draws can be left out: what remains is what a machine with a graphics card would wait for.
WATCH = """(() => {
  window.__events = [];
  window.__skipDrawing = false;
  const note = (what, size) => window.__events.push([what, performance.now(), size]);
  const gl2 = WebGL2RenderingContext.prototype;
  let armed = false;
  for (const name of ['bufferData', 'bufferSubData']) {
    const original = gl2[name];
    gl2[name] = function (...a) {
      const data = a[name === 'bufferData' ? 1 : 2];
      const size = (data && data.byteLength) || 0;
      if (size >= 36) { note('upload', size); armed = true; }
      return original.apply(this, a);
    };
  }
  for (const name of ['drawElements', 'drawArrays', 'drawElementsInstanced',
                      'drawArraysInstanced']) {
    const original = gl2[name];
    gl2[name] = function (...a) {
      const count = name.startsWith('drawElements') ? a[1] : a[2];
      const copies = name.endsWith('Instanced') ? a[a.length - 1] : 1;
      const large = count * copies > 3000;
      if (!(large && window.__skipDrawing)) original.apply(this, a);
      if (armed) {
        armed = false;
        note('draw', count * copies);
        const fence = this.fenceSync(this.SYNC_GPU_COMMANDS_COMPLETE, 0);
        this.flush();
        const poll = () => {
          const state = this.clientWaitSync(fence, 0, 0);
          if (state === this.ALREADY_SIGNALED || state === this.CONDITION_SATISFIED) {
            this.deleteSync(fence); note('done', 0);
          } else setTimeout(poll, 1);
        };
        setTimeout(poll, 0);
      }
    };
  }
  document.addEventListener('mousemove', () => note('input', 0), true);
  new MutationObserver((changes) => {
    for (const change of changes) {
      for (const node of change.addedNodes) {
        if (node.querySelector && node.querySelector('[data-testid=verdict]')) note('card', 0);
      }
      if (change.target.querySelector && change.target.querySelector('[data-testid=verdict]')) {
        note('card', 0);
      }
    }
  }).observe(document, { childList: true, subtree: true, characterData: true });
})();"""


@dataclass(frozen=True)
class Row:
    """Medians of one slider [ms]."""

    path: str
    server: float
    graphics_card: float
    software: float


def measure_server(viewer: Viewer, path: str) -> float:
    """Time register_pair and the making of the messages, each value new to the memo."""
    memo = Memo()
    state = viewer.state
    register_pair(state.query, state.database, PARAMS, memo)
    seconds: list[float] = []
    for value in VALUES[path]:
        params = with_path(PARAMS, path, value)
        changed = type(state)(
            state.dataset, state.query_id, state.database_id, params, state.options
        )
        start = time.perf_counter()
        result = register_pair(state.query, state.database, params, memo)
        viewer._scene.show(changed, result)
        seconds.append(time.perf_counter() - start)
    return 1000 * statistics.median(seconds)


def measure_browser(page: ViewerPage, path: str, *, skip_drawing: bool) -> float:
    """Time from a mouse move on the slider to the drawn change."""
    page.page.evaluate(f"window.__skipDrawing = {str(skip_drawing).lower()}")
    label = MAIN_PARAMETERS[path]
    box: Any = page.thumb(label).bounding_box()
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    page.page.mouse.move(x, y)
    page.page.mouse.down()
    milliseconds: list[float] = []
    try:
        for event in range(1, EVENTS + 1):
            quiet(page)
            page.page.evaluate("window.__events.length = 0")
            # Away and further away: each position is a value that the memo has not seen.
            between = 0.0 if skip_drawing else 0.5  # values that the first round has not asked for
            page.page.mouse.move(x + STRIDES[path] * (event + between), y)
            shown = "draw" if skip_drawing else "done"
            change = wait_for_change(page, "card" if "min_inliers" in path else shown)
            if change is not None:
                milliseconds.append(change)
    finally:
        page.page.mouse.up()
    if len(milliseconds) < EVENTS / 2:
        raise AssertionError(f"{label}: only {len(milliseconds)} of {EVENTS} moves showed a change")
    page.press("Reset parameters")
    quiet(page)
    return statistics.median(milliseconds)


def wait_for_change(page: ViewerPage, shown: str) -> float | None:
    """Wait for all that one input changes; give the time from it to the last change shown.

    None if it changed nothing, as when the same associations are inliers at another radius.
    """
    cause = "card" if shown == "card" else "upload"
    end = time.monotonic() + 4
    while time.monotonic() < end:
        quiet(page)
        events = page.page.evaluate("window.__events")
        causes = [moment for what, moment, _ in events if what == cause]
        after = [
            moment
            for what, moment, _ in events
            if what == shown and causes and moment >= causes[-1]
        ]
        if causes and after:
            return after[0] - next(moment for what, moment, _ in events if what == "input")
    return None


def quiet(page: ViewerPage, seconds: float = 0.6) -> None:
    """Wait until the status is up to date and nothing was uploaded or drawn for a while."""
    end = time.monotonic() + 60
    last, since = -1, time.monotonic()
    while time.monotonic() < end:
        count = page.page.evaluate("window.__events.length")
        if count != last or "Up to date" not in page.status():
            last, since = count, time.monotonic()
        elif time.monotonic() - since > seconds:
            return
        page.page.wait_for_timeout(50)
    raise AssertionError("the page never came to rest")


def main() -> int:
    """Measure and print; 1 if a target is missed on a machine with a graphics card."""
    executable = find_chromium()
    if executable is None:
        print("no Chromium found; name one in GPGRAD_CHROMIUM")  # noqa: T201
        return 2
    viewer = Viewer(load_dataset(demo_path()), PARAMS, port=0)
    viewer.wait_idle()
    server = {path: measure_server(viewer, path) for path in TARGETS_MS}
    rows: list[Row] = []
    with launch(executable) as browser:
        page = ViewerPage(browser, viewer.url, script=WATCH)
        for path in TARGETS_MS:
            without = measure_browser(page, path, skip_drawing=True)
            rows += [
                Row(path, server[path], without, measure_browser(page, path, skip_drawing=False))
            ]
        page.close()
    viewer.close()
    print(f"{'slider':28} {'server':>8} {'GPU machine':>12} {'software':>9} {'target':>7}  [ms]")  # noqa: T201
    for row in rows:
        print(  # noqa: T201
            f"{row.path:28} {row.server:8.0f} {row.graphics_card:12.0f} {row.software:9.0f} "
            f"{TARGETS_MS[row.path]:7d}"
        )
    return int(any(row.graphics_card > TARGETS_MS[row.path] for row in rows))


if __name__ == "__main__":
    sys.exit(main())
