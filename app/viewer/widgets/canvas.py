"""The canvas of each page: how large it is, what covers it, and what is written over it.

The page watches its canvas and says what becomes of it. What is written over the canvas lets all
clicks through. It hangs on the page's body, because panels that hold it could be put away.
"""

import math
import weakref
from collections.abc import Callable
from typing import TypeAlias

import numpy as np
import viser

from app.viewer.draw.cameras import set_view, view_of
from app.viewer.draw.layers import Scale
from app.viewer.draw.placement import UNKNOWN_CANVAS, Camera, Canvas
from app.viewer.host import Host
from app.viewer.widgets.bridge import Bridge, Data, run_when_shown

OnCanvas: TypeAlias = Callable[[viser.ClientHandle], None]

LONGEST_SIDE = 100_000.0
"""Of any screen [pixels]."""
RECENT = 4
"""Views that a page was brought to last; it may report one of these late."""
SAME_SHAPE = 0.02
"""By which width over height may differ because pixels are whole."""
BY_HAND = 0.01
"""A camera that is farther from where it was brought, in distances of what is looked at, was moved
by hand."""

# `cover` finds what floats over the canvas, and leaves the largest of the strips beside it. What
# opens for a moment, such as a list, does not count.
SCRIPT = """
(function run() {
  if (!window.gpgrad) { setTimeout(run, 50); return; }  // the bridge may come later
  if (window.gpgradCanvas) { window.gpgradCanvas.last = ''; return; }
  const own = window.gpgradCanvas = {last: '', height: 0, left: 0, top: 0};
  const make = (parent, style, tag = 'div') => {
    const made = document.createElement(tag);
    made.style.cssText = style;
    return parent.appendChild(made);
  };
  const ground = 'background:color-mix(in srgb,var(--mantine-color-body) 78%,transparent);' +
    'border-radius:.35em;padding:.15em .55em;';
  // Where a caption of the scene may lie behind it, only the letters have a ground.
  const halo = 'text-shadow:' + Array(4).fill('0 0 2px var(--mantine-color-body)') + ';';
  const over = make(document.body, 'position:fixed;pointer-events:none;z-index:1;overflow:hidden;' +
    'color:var(--mantine-color-text);font:13px/1.35 var(--mantine-font-family)');
  over.dataset.testid = 'over-canvas';
  const caption = make(over, 'position:absolute;top:10px;left:50%;transform:translateX(-50%);' +
    'max-width:92%;text-align:center;' + ground);
  caption.dataset.testid = 'caption';
  const title = make(caption, 'font-weight:600;font-size:14px');
  const line = make(caption, '');
  const scale = make(over, 'position:absolute;left:14px;bottom:12px;text-align:center;' + ground);
  scale.dataset.testid = 'scale';
  const words = make(scale, 'font-variant-numeric:tabular-nums');
  const bar = make(scale, 'height:5px;border:1.5px solid currentColor;border-top:0;' +
    'margin:0 auto 3px');
  const svg = document.createElementNS('http://www.w3.org/2000/svg', 'svg');
  const frame = make(over, 'position:absolute;right:14px;bottom:12px;display:flex;gap:.5em;' +
    'align-items:flex-end;font-size:12px;padding:.15em .55em;' + halo);
  frame.dataset.testid = 'axes';
  const note = make(frame, '');
  frame.appendChild(svg);
  svg.setAttribute('width', 46); svg.setAttribute('height', 46);
  svg.setAttribute('viewBox', '-23 -23 46 46');
  const axes = ['x', 'y'].map(name => {
    const add = (kind, values) => {
      const made = document.createElementNS('http://www.w3.org/2000/svg', kind);
      for (const key in values) made.setAttribute(key, values[key]);
      return svg.appendChild(made);
    };
    const stroke = add('line', {x1: 0, y1: 0, stroke: 'currentColor', 'stroke-width': 1.8});
    const label = add('text', {'text-anchor': 'middle', 'dominant-baseline': 'central',
      'font-size': 12, 'font-weight': 600, fill: 'currentColor'});
    label.textContent = name;
    return (x, y) => {
      const long = Math.hypot(x, y) || 1;
      stroke.setAttribute('x2', 12 * x); stroke.setAttribute('y2', 12 * y);
      label.setAttribute('x', 12 * x + 7 * x / long);
      label.setAttribute('y', 12 * y + 7 * y / long);
    };
  });
  for (const part of [caption, scale, frame]) part.style.visibility = 'hidden';
  gpgrad.acts.caption = data => {
    title.textContent = data.title; line.textContent = data.line; note.textContent = data.frame;
    line.style.display = data.line ? '' : 'none';
    caption.style.visibility = data.title ? '' : 'hidden';
    own.cursor = data.cursor;
    if (!own.cursor) gpgrad.acts.marks({places: []});
  };
  const rings = [0, 1].map(() => make(over, 'position:absolute;width:20px;height:20px;' +
    'margin:-13px 0 0 -13px;border-radius:50%;border:3px solid;box-shadow:0 0 0 2px #000,' +
    'inset 0 0 0 2px #000;visibility:hidden'));
  for (const ring of rings) ring.dataset.testid = 'cursor-mark';
  gpgrad.acts.marks = data => rings.forEach((ring, k) => {
    const place = own.cursor && data.places[k];
    ring.style.visibility = place ? '' : 'hidden';
    if (!place) return;
    ring.style.borderColor = data.color;
    ring.style.left = place[0] - own.left + 'px'; ring.style.top = place[1] - own.top + 'px';
  });
  // By its full name: in an inline handler, the short one is the element's own.
  window.addEventListener('pointermove', event => {
    const canvas = document.querySelector('canvas');
    if (!own.cursor || !canvas) return;
    const box = canvas.getBoundingClientRect();
    const inside = canvas.parentElement.contains(event.target);
    const [x, y] = inside ? [event.clientX - box.left, event.clientY - box.top] : [-1e4, -1e4];
    gpgrad.say('cursor', {x, y}, true);
  });
  // The bar is a share of the canvas's height, so that it is true while the canvas changes.
  own.stretch = () => { bar.style.width = (own.share || 0) * own.height + 'px'; };
  gpgrad.acts.camera = data => {
    own.share = data.share; own.stretch(); words.textContent = data.length;
    data.axes.forEach((end, k) => axes[k](end[0], end[1]));
    scale.style.visibility = frame.style.visibility = '';
  };
  const cover = canvas => {
    const none = {left: 0, top: 0, right: 0, bottom: 0};
    const seen = [...document.querySelectorAll('.mantine-Paper-root')].filter(one => {
      const style = getComputedStyle(one), box = one.getBoundingClientRect();
      return (style.position === 'absolute' || style.position === 'fixed') && box.width > 150 &&
        box.height > 60 && style.visibility !== 'hidden' && !one.closest(
          '[role=dialog],[role=listbox],[role=alert],.mantine-Notifications-root,' +
          '.mantine-Popover-dropdown,.mantine-Tooltip-tooltip');
    }).map(one => one.getBoundingClientRect()).filter(box => box.right > canvas.left + 1 &&
      box.left < canvas.right - 1 && box.bottom > canvas.top + 1 && box.top < canvas.bottom - 1);
    if (!seen.length) return none;
    const least = side => Math.min(...seen.map(box => box[side]));
    const most = side => Math.max(...seen.map(box => box[side]));
    const strips = [
      [least('left') - canvas.left, canvas.height, {...none, right: canvas.right - least('left')}],
      [canvas.right - most('right'), canvas.height, {...none, left: most('right') - canvas.left}],
      [canvas.width, least('top') - canvas.top, {...none, bottom: canvas.bottom - least('top')}],
      [canvas.width, canvas.bottom - most('bottom'), {...none, top: most('bottom') - canvas.top}],
    ].sort((a, b) => b[0] * b[1] - a[0] * a[1]);
    const [width, height, margins] = strips[0];
    return width > 80 && height > 80 ? margins : none;
  };
  setInterval(() => {
    const canvas = document.querySelector('canvas');
    if (!canvas) return;
    const box = canvas.getBoundingClientRect();
    if (box.width < 1 || box.height < 1) return;
    const found = {width: box.width, height: box.height, ...cover(box)};
    const now = JSON.stringify(found);
    if (now === own.last) return;
    own.last = now;
    own.height = box.height; own.left = found.left; own.top = found.top; own.stretch();
    over.style.left = box.left + found.left + 'px'; over.style.top = box.top + found.top + 'px';
    over.style.width = box.width - found.left - found.right + 'px';
    over.style.height = box.height - found.top - found.bottom + 'px';
    gpgrad.say('canvas', found, true);
  }, 200);
})()
"""


class Canvases:
    """What is known of the pages' canvases, and where their cameras were brought.

    Attributes:
        caption: What is written over all of them.
        scales: What the colours mean in each subject of the scene; None if nothing is coloured.
    """

    def __init__(self, host: Host, bridge: Bridge) -> None:
        """Put the script into the current container, unseen.

        Args:
            host: Whose pages are watched.
            bridge: Of the same pages.
        """
        self._bridge = bridge
        self._known: weakref.WeakKeyDictionary[viser.ClientHandle, Canvas] = (
            weakref.WeakKeyDictionary()
        )
        self._brought: weakref.WeakKeyDictionary[viser.ClientHandle, tuple[Camera, ...]] = (
            weakref.WeakKeyDictionary()
        )
        self._told: list[OnCanvas] = []
        self.caption: dict[str, str] = {}
        self.scales: dict[str, Scale | None] = {}
        host.gui.add_html(run_when_shown(SCRIPT))
        bridge.hear("canvas", self._take)

    def tell(self, act: OnCanvas) -> None:
        """Call something whenever a page's canvas is there, or becomes another; must be quick."""
        self._told.append(act)

    def of(self, page: viser.ClientHandle) -> Canvas:
        """Give the canvas of a page, or a usual one while the page has not said."""
        return self._known.get(page, UNKNOWN_CANVAS)

    def knows(self, page: viser.ClientHandle) -> bool:
        """Say whether a page has said how large its canvas is."""
        return page in self._known

    def bring(self, page: viser.ClientHandle, camera: Camera) -> None:
        """Bring a page's camera to a view of all that is shown, from which it may be refitted."""
        self.expect(page, camera)
        set_view(page, camera)

    def expect(self, page: viser.ClientHandle, camera: Camera) -> None:
        """Take a view of all that is shown to which something else brings a page's camera."""
        self._brought[page] = (camera, *self._brought.get(page, ()))[:RECENT]

    def is_by_hand(self, page: viser.ClientHandle) -> bool:
        """Say whether a page's camera is elsewhere than it was brought."""
        brought = self._brought.get(page)
        if not brought:
            return False
        now = view_of(page)
        return all(not _is_near(now, camera) for camera in brought)

    def show(self, page: viser.ClientHandle, act: str, data: object) -> None:
        """Write something over a page's canvas: ``caption``, ``camera`` or ``marks``."""
        self._bridge.call(page, act, data)

    def measure(self, page: viser.ClientHandle) -> None:
        """Take a page's new shape from its camera: with its panels put away, it says nothing else.

        The camera counts other pixels than the page, so that only the shape is certain.
        """
        known = self._known.get(page)
        aspect = page.camera.aspect
        if known is None or abs(aspect / known.aspect - 1.0) < SAME_SHAPE:
            return
        self._set(page, Canvas(known.height * aspect, known.height))

    def _take(self, page: viser.ClientHandle, data: Data) -> None:
        canvas = read_canvas(data)
        if canvas is not None:
            self._set(page, canvas)

    def _set(self, page: viser.ClientHandle, canvas: Canvas) -> None:
        self._known[page] = canvas
        for act in self._told:
            act(page)


def read_canvas(data: Data) -> Canvas | None:
    """Read what a page says of its canvas; None if that can be no canvas."""
    names = ("width", "height", "left", "top", "right", "bottom")
    values: list[float] = []
    for name in names:
        value = data.get(name)
        if isinstance(value, bool) or not isinstance(value, float | int):
            return None
        values.append(float(value))
    if not all(math.isfinite(value) and 0.0 <= value <= LONGEST_SIDE for value in values):
        return None
    canvas = Canvas(*values)
    across, along = canvas.width - canvas.left - canvas.right, canvas.height - canvas.top
    if across < 1.0 or along - canvas.bottom < 1.0:
        return None
    return canvas


def _is_near(first: Camera, second: Camera) -> bool:
    reach = BY_HAND * float(np.linalg.norm(np.subtract(second.position, second.look_at)))
    return bool(
        np.linalg.norm(np.subtract(first.position, second.position)) < reach
        and np.linalg.norm(np.subtract(first.look_at, second.look_at)) < reach
    )
