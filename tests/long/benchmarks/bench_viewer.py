"""How fast the picture follows a slider: ``python -m tests.long.benchmarks.bench_viewer``.

Two submaps of 5,000 points at 0.03 m/pixel, real mouse events in a real browser, whose driver lets
go of the page while it is timed (see `unwatched`). Printed are medians, in milliseconds, of

- server: from the parameters to the messages, without a browser, and its process time;
- GPU machine: from the mouse event to the new vertices handed to the graphics library and the
  draw call that uses them, with the drawing itself left out: a graphics card does that, where
  here a software renderer would take a processor from the server that is measured;
- software: the same until the software renderer has finished the picture.

Each for the first picture that changes, which may be a coarse one or surfaces without what is
found on them, and for the whole one. Where numbers that are automatic are fitted anew to a slider's
value, another picture follows once they are; the last column says when, without drawing. The
thresholds of the verdict change the picture only where it turns, so for them the verdict card
counts.
"""

import statistics
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import inf

from app.viewer.features.params.tab import MAIN_PARAMETERS
from app.viewer.session import state as states
from app.viewer.viewer import Viewer
from gpgrad_core.detection import PipelineParams
from gpgrad_core.io.folder import load_dataset
from gpgrad_core.mapping.gradient_map import MapParams, kept_points
from gpgrad_core.params import with_path
from gpgrad_core.run import silent
from gpgrad_core.simulation.demo import demo_path
from gpgrad_core.types import Dataset, Submap
from tests.browser.chromium import find_chromium
from tests.long.benchmarks.unwatched import UnwatchedPage, open_unwatched

NUM_POINTS = 5000
PARAMS = PipelineParams(map=MapParams(resolution=0.03))
TARGETS_MS = {
    "features.max_std_ratio": (150, 500),
    "registration.inlier_radius": (150, 150),
    "closure.min_inliers": (150, 150),
    "closure.min_score": (150, 150),
    "map.length_scale": (150, 500),
    "map.noise_std": (150, 500),
}
"""Of the first picture, and of the whole one."""
CARD_ONLY = ("closure.min_inliers", "closure.min_score")
VALUES = {
    "features.max_std_ratio": [0.20, 0.22, 0.24, 0.26, 0.28, 0.32, 0.34, 0.36],
    "registration.inlier_radius": [0.14, 0.16, 0.18, 0.2, 0.22, 0.24, 0.26, 0.32],
    "closure.min_inliers": [3, 4, 5, 6, 7, 9, 10, 11],
    "closure.min_score": [0.5, 1.0, 1.5, 2.0, 2.5, 3.5, 4.0, 4.5],
    "map.length_scale": [0.26, 0.27, 0.28, 0.29, 0.31, 0.32, 0.33, 0.34],
    "map.noise_std": [0.02, 0.025, 0.03, 0.035, 0.04, 0.06, 0.065, 0.07],
}
STRIDES = {
    "features.max_std_ratio": -3,
    "registration.inlier_radius": -4,
    "closure.min_inliers": 8,
    "closure.min_score": 4,
    "map.length_scale": 1,
    "map.noise_std": 1,
}
"""How far one event moves the thumb [pixels]."""
EVENTS = 8
UNWATCHED = 0.8
"""Seconds after an event in which the page is left alone: every question takes it time too."""
HEAD = "".join(
    f"{name:>16}" for name in ("server", "its process", "GPU machine", "software", "target")
)

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
      if (!window.__skipDrawing) original.apply(this, a);
      if (armed) {
        armed = false;
        note('draw', 0);
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
  for (const name of ['clear', 'texSubImage2D']) {
    const original = gl2[name];
    gl2[name] = function (...a) { if (!window.__skipDrawing) return original.apply(this, a); };
  }
  document.addEventListener('mousemove', () => note('input', 0), true);
  new MutationObserver((changes) => {
    for (const change of changes) {
      for (const node of change.addedNodes) {
        if (node.querySelector && node.querySelector('[data-testid=verdict]')) note('card', 0);
      }
      const text = change.target.textContent;
      if (text.includes('Fitting automatic numbers')) note('fit', 0);
      else if (/Surfaces shown|Coarse picture|Up to date/.test(text)) note('other', 0);
      if (change.target.querySelector && change.target.querySelector('[data-testid=verdict]')) {
        note('card', 0);
      }
    }
  }).observe(document, { childList: true, subtree: true, characterData: true });
})();"""


@dataclass(frozen=True)
class Times:
    """Of one change: to the first picture, to the whole one, and to that of fitted numbers [ms]."""

    first: float
    last: float
    fitted: float = 0.0

    @classmethod
    def median(cls, times: list["Times"]) -> "Times":
        """Take the medians."""
        return cls(
            statistics.median(time.first for time in times),
            statistics.median(time.last for time in times),
            statistics.median(time.fitted for time in times),
        )


def small_demo() -> Dataset:
    """Load the demo with `NUM_POINTS` points a submap."""
    demo = load_dataset(demo_path())
    submaps = tuple(
        Submap.from_points(kept_points(submap, NUM_POINTS), submap.id) for submap in demo.submaps
    )
    return replace(demo, submaps=submaps)


def measure_server(viewer: Viewer, path: str) -> tuple[Times, Times]:
    """Time the runner's two stages, each value new to the memo; wall clock, and process time."""
    wall: list[Times] = []
    process: list[Times] = []
    (session,) = viewer.sessions
    state = session.state
    for value in VALUES[path]:
        changed = states.with_params(state, with_path(PARAMS, path, value))
        start, start_process = time.perf_counter(), time.process_time()
        rough = session.pair.preview(changed, silent)
        first = time.perf_counter() - start, time.process_time() - start_process
        if session.pair.stand_in(changed, silent) is None:
            session.pair.compute(changed, silent)
        last = time.perf_counter() - start, time.process_time() - start_process
        if rough is None:
            first = last
        wall.append(Times(1000 * first[0], 1000 * last[0]))
        process.append(Times(1000 * first[1], 1000 * last[1]))
    return Times.median(wall), Times.median(process)


def measure_browser(page: UnwatchedPage, path: str, *, skip_drawing: bool) -> Times:
    """Time from a mouse move on the slider to the drawn changes."""
    page.evaluate(f"window.__skipDrawing = {str(skip_drawing).lower()}")
    label = MAIN_PARAMETERS[path]
    x, y = page.thumb(label)
    page.mouse("Pressed", x, y)
    times: list[Times] = []
    at = x
    for event in range(1, EVENTS + 1):
        quiet(page)
        page.evaluate("window.__events.length = 0")
        # Away and further away: each position is a value that the memo has not seen.
        between = 0.0 if skip_drawing else 0.5  # values that the first round has not asked for
        at = x + STRIDES[path] * (event + between)
        page.mouse("Moved", at, y)
        time.sleep(UNWATCHED)
        shown = "draw" if skip_drawing else "done"
        change = wait_for_change(page, "card" if path in CARD_ONLY else shown)
        if change is not None:
            times.append(change)
    page.mouse("Released", at, y)
    if len(times) < EVENTS / 2:
        raise AssertionError(f"{label}: only {len(times)} of {EVENTS} moves showed a change")
    page.press("Reset parameters")
    quiet(page)
    return Times.median(times)


def wait_for_change(page: UnwatchedPage, shown: str) -> Times | None:
    """Wait for all that one input changes; give the times from it to what was shown.

    None if it changed nothing, as when the same associations are inliers at another radius.
    """
    cause = "card" if shown == "card" else "upload"
    end = time.monotonic() + 4
    while time.monotonic() < end:
        quiet(page)
        events = page.evaluate("window.__events")
        causes = [moment for what, moment, _ in events if what == cause]
        moments = [moment for what, moment, _ in events if what == shown]
        if causes and moments and moments[-1] >= causes[-1]:
            begin = next(moment for what, moment, _ in events if what == "input")
            fit = next((moment for what, moment, _ in events if what == "fit"), inf)
            fitted = next((at for what, at, _ in events if what == "other" and at > fit), inf)
            whole = max(moment for moment in causes if moment <= max(fitted, causes[0]))
            first, last, final = (
                next(moment for moment in moments if moment >= cause) - begin
                for cause in (causes[0], whole, causes[-1])
            )
            return Times(first, last, final if final > last else 0.0)
    return None


def quiet(page: UnwatchedPage, seconds: float = 0.6) -> None:
    """Wait until the status is up to date and nothing was uploaded or drawn for a while."""
    end = time.monotonic() + 60
    last, since = -1, time.monotonic()
    while time.monotonic() < end:
        count = page.evaluate("window.__events.length")
        if count != last or "Up to date" not in page.status():
            last, since = count, time.monotonic()
        elif time.monotonic() - since > seconds:
            return
        time.sleep(0.05)
    raise AssertionError("the page never came to rest")


def main(paths: Sequence[str] = tuple(TARGETS_MS)) -> int:
    """Measure and print; 1 if a target is missed on a machine with a graphics card."""
    executable = find_chromium()
    if executable is None:
        print("no Chromium found; name one in GPGRAD_CHROMIUM")  # noqa: T201
        return 2
    viewer = Viewer(small_demo(), PARAMS, port=0)
    viewer.wait_idle()
    server = {path: measure_server(viewer, path) for path in paths}
    missed = False
    with open_unwatched(executable, viewer.url, WATCH) as page:
        print(f"{'slider':28}{HEAD}   [ms, first picture / whole]")  # noqa: T201
        for path in paths:
            without = measure_browser(page, path, skip_drawing=True)
            drawn = measure_browser(page, path, skip_drawing=False)
            target = Times(*TARGETS_MS[path])
            cells = "".join(
                f"{f'{times.first:.0f} / {times.last:.0f}':>16}"
                for times in (*server[path], without, drawn, target)
            )
            then = f"   fitted after {without.fitted:.0f}" if without.fitted else ""
            print(f"{path:28}{cells}{then}", flush=True)  # noqa: T201
            missed |= without.first > target.first or without.last > target.last
    viewer.close()
    return int(missed)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:] or tuple(TARGETS_MS)))
