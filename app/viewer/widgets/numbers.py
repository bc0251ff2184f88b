"""Numbers that a person types, and presses of the pointer or a key that move one.

viser's number boxes leave out what they take for no part of a number while it is typed: "0,8"
becomes 8, and "1e9" 19. So a script of ours keeps the boxes to itself while a person types, and
says the whole text once it is complete: with Enter, or when the box is left. What it means is
decided here. The script also says where a slider was let go: until then, it is on its way.

This depends on how viser builds its pages, as the bridge does, and a browser test watches it.
"""

import re
from collections.abc import Callable
from typing import Any

import viser

from app.viewer.host import Host
from app.viewer.widgets.bridge import Bridge, Data, run_when_shown
from app.viewer.widgets.look import uuid_of
from gpgrad_core.errors import InputError
from gpgrad_core.params.bounds import Bounds

NUMBER = re.compile(r"[+-]?(\d+[.,]?\d*|[.,]\d+)(e[+-]?\d+)?", re.ASCII | re.IGNORECASE)
GROUPS = re.compile(r"[+-]?[1-9]\d{0,2},\d{3}", re.ASCII)
"""One comma that may part thousands as well as decimals."""
LONGEST = 40
"""Characters of such a number; what is longer is none."""
REST_MS = 60
"""A page says where something was let go after its last value, which viser may keep for 50 ms."""
MOST_MOVES = 50
"""That a page says at once: of more presses without a pause, the last ones."""

# What a page's own listeners would do with what is typed must not happen: the script hears it
# first, and goes no further with it. Scripts that set a box, as that of the decades does, are let
# through. `typing` is the box in which a person types, and `said` are the boxes that wait to be
# answered; both know what viser has written there.
SCRIPT = """
(function run() {
  if (!window.gpgrad) { setTimeout(run, 50); return; }  // the bridge may come later
  if (window.gpgradNumbers) return;
  window.gpgradNumbers = true;
  const SLIDER = '.mantine-Slider-root', FIELD = '.mantine-NumberInput-root';
  const MOVING = /^(Arrow(Up|Down|Left|Right)|Page(Up|Down)|Home|End)$/;
  const find = at => {
    const part = at && at.closest && at.closest(`${SLIDER},${FIELD}`);
    if (!part) return null;
    const isField = part.matches(FIELD);
    const beside = isField ? part.previousElementSibling : part.nextElementSibling;
    const slider = isField ? (beside?.matches(SLIDER) ? beside : null) : part;
    const field = isField ? part : (beside?.matches(FIELD) ? beside : null);
    const box = field && field.querySelector('input:not([type=hidden])');
    return box && {id: (slider || box).id, slider, box};
  };
  const put = (box, text) =>
    Object.getOwnPropertyDescriptor(HTMLInputElement.prototype, 'value').set.call(box, text);
  let typing = null;
  const said = new Map();
  const commit = () => {
    const {id, box, before} = typing;
    typing = null;
    if (box.value === before) return;
    rest();
    said.set(id, {box, before, text: box.value});
    gpgrad.say('typed', {widget: id, text: box.value});
  };
  const why = document.createElement('div');
  why.dataset.testid = 'not-taken';
  why.setAttribute('role', 'alert');
  gpgrad.acts.typed = ({widget, changed, refused}) => {
    const {box, before, text} = said.get(widget) ?? {};
    said.delete(widget);
    if (!box || !box.isConnected) return;
    if (!changed && box.value === text && typing?.box !== box) put(box, before);
    if (!refused) return;
    const {left, right, bottom} = box.getBoundingClientRect(), beyond = window.innerWidth - right;
    why.style.cssText = 'position:fixed;z-index:1000;max-width:19em;padding:.35em .6em;' +
      'border-radius:.3em;background:#a32a25;color:#fff;pointer-events:none;' +
      'font:600 13px/1.35 var(--mantine-font-family);top:' + (bottom + 4) + 'px;' +
      (left > beyond ? `right:${beyond}px` : `left:${left}px`);
    why.textContent = refused;
    document.body.appendChild(why);
  };
  const hear = (names, act) => {
    for (const name of names) window.addEventListener(name, act, {capture: true, passive: false});
  };
  hear(['keydown', 'mousedown', 'touchstart', 'wheel'], () => why.remove());
  hear(['beforeinput', 'input', 'change', 'paste'], event => {
    const found = event.isTrusted && find(event.target);
    if (!found || event.target !== found.box) return;
    event.stopImmediatePropagation();
    if (event.type === 'beforeinput' && typing?.box !== found.box) {
      typing = {...found, before: said.get(found.id)?.before ?? found.box.value};
    }
  });
  hear(['focusout'], event => {
    if (typing?.box !== event.target) return;
    event.stopImmediatePropagation();
    commit();
  });
  hear(['keydown'], event => {
    const found = find(event.target), isBox = found && found.box === event.target;
    if (found && MOVING.test(event.key) && !event.repeat) press(found);
    if (!isBox || event.ctrlKey || event.metaKey || event.altKey) return;
    const mine = typing?.box === event.target;
    if (mine && ['Enter', 'Escape', 'ArrowUp', 'ArrowDown'].includes(event.key)) {
      if (event.key === 'Escape') { put(typing.box, typing.before); typing = null; }
      else commit();
      event.preventDefault();
      event.stopImmediatePropagation();
    } else if (found.slider && /^Arrow(Up|Down)$/.test(event.key)) {  // as on the slider itself
      event.preventDefault();
      event.stopImmediatePropagation();
      const key = event.key === 'ArrowUp' ? 'ArrowRight' : 'ArrowLeft';
      found.slider.querySelector('[role=slider]').dispatchEvent(
        new KeyboardEvent('keydown', {key, bubbles: true, cancelable: true, repeat: event.repeat}));
      found.box.focus();
    } else if (mine || event.key.length === 1 || ['Backspace', 'Delete'].includes(event.key)) {
      event.stopImmediatePropagation();
    }
  });

  // Where sliders were let go. What a panel of viser's sends at about the same time can push each
  // other out, so it is said once no hand moves anything any more: all of it, in order.
  let pressed = null, resting = null, timer = 0, moves = [];
  const read = ({slider, box}) => slider
    ? +slider.querySelector('[role=slider]').getAttribute('aria-valuenow') : parseFloat(box.value);
  const note = () => {
    if (!resting) return;
    const {id, was} = resting, value = read(resting);
    resting = null;
    const shown = isFinite(value) && value !== was;  // a busy page shows it later
    if (!said.has(id)) moves = [...moves, `${id} ${shown ? value : ''}`].slice(-MOST_MOVES);
  };
  function rest() {
    clearTimeout(timer);
    note();
    if (moves.length) gpgrad.say('rested', {moves: moves.join(';')});
    moves = [];
  }
  function press(found) {
    clearTimeout(timer);
    note();
    pressed = found && {...found, was: read(found)};
  }
  const letGo = () => {
    if (!pressed) return;
    const mine = resting = pressed;
    pressed = null;
    requestAnimationFrame(() => {
      if (resting === mine) timer = setTimeout(rest, REST_MS);
    });
  };
  hear(['mousedown', 'touchstart'], event => {
    const found = find(event.target);
    if (found && event.target !== found.box) press(found);
  });
  hear(['mouseup', 'touchend', 'touchcancel'], letGo);
  hear(['keyup'], event => { if (MOVING.test(event.key)) letGo(); });
})()
""".replace("REST_MS", str(REST_MS)).replace("MOST_MOVES", str(MOST_MOVES))


class Numbers:
    """Takes what is typed into the number boxes of a session, and where its sliders come to rest.

    Attributes:
        refuse: Given why a number was not taken.
        rested: Given the name of a widget, and the value at which it was let go; None for the last
            that it has sent.
    """

    def __init__(self, host: Host, bridge: Bridge) -> None:
        """Put the script into the current container, unseen.

        Args:
            host: Whose pages it is for.
            bridge: Hears them.
        """
        self.refuse: Callable[[str], None] = lambda why: None  # noqa: ARG005
        self.rested: Callable[[str, float | None], None] = lambda widget, value: None  # noqa: ARG005
        self._bridge = bridge
        self._boxes: dict[str, tuple[viser.GuiInputHandle[Any], Callable[[str], None]]] = {}
        host.gui.add_html(run_when_shown(SCRIPT))
        bridge.hear("typed", self._hear_typed)
        bridge.hear("rested", self._hear_rested)

    def add(
        self,
        handle: viser.GuiInputHandle[Any],
        bounds: Bounds | None,
        act: Callable[[float], None],
    ) -> None:
        """Call something with each number that is typed into a box.

        Args:
            handle: A number box, or a slider, which has one beside it.
            bounds: What may be typed.
            act: Given the number; it shows what came of it. What it refuses with `InputError` is
                told.
        """
        name, _, _ = str(handle.label).partition(" [")
        whole = isinstance(handle.value, int)
        self._boxes[uuid_of(handle)] = (
            handle,
            lambda text: act(read_number(text, name, bounds, whole=whole)),
        )

    def _hear_typed(self, page: viser.ClientHandle, data: Data) -> None:
        widget, text = data.get("widget"), data.get("text")
        if not isinstance(widget, str) or not isinstance(text, str) or widget not in self._boxes:
            return
        handle, take = self._boxes[widget]
        before, refused = handle.value, ""
        try:
            take(text)
        except InputError as error:
            refused = str(error)
            self.refuse(refused)
        # A number that is the same as before is sent to no page: this one writes it anew.
        changed = handle.value != before
        answer = {"widget": widget, "changed": changed, "refused": refused}
        self._bridge.call(page, "typed", answer)

    def _hear_rested(self, page: viser.ClientHandle, data: Data) -> None:
        del page
        moves = data.get("moves")
        for move in moves.split(";")[:MOST_MOVES] if isinstance(moves, str) else ():
            widget, _, value = move.partition(" ")
            try:
                self.rested(widget, float(value) if value else None)
            except (ValueError, OverflowError):
                return  # no page of ours says so


def read_number(text: str, name: str, bounds: Bounds | None = None, *, whole: bool) -> float:
    """Read what a person typed; a decimal comma is a point.

    >>> read_number("0,8", "Noise", whole=False), read_number("1e3", "Points", whole=True)
    (0.8, 1000)

    Args:
        text: What was typed.
        name: What the message calls it.
        bounds: What it may be; None for anything.
        whole: Whether it must be a whole number.

    Raises:
        InputError: If it is no number, if it can be read in two ways, or if it is out of bounds.
    """
    typed = text.strip().replace("\N{MINUS SIGN}", "-")
    said = repr(typed if len(typed) <= LONGEST else typed[:LONGEST] + "…") if typed else "nothing"
    if len(typed) > LONGEST or not NUMBER.fullmatch(typed):
        raise InputError(f"{name} must be a number such as {'20' if whole else '0.8'}, got {said}")
    if GROUPS.fullmatch(typed) or (whole and "," in typed):
        plain, point = typed.replace(",", ""), typed.replace(",", ".")
        raise InputError(f"{name}: {said} can be read in two ways; write {plain} or {point}")
    number = float(typed.replace(",", "."))
    if bounds is not None and not bounds.low <= number <= bounds.high:
        raise InputError(f"{name} must be from {bounds.range}, got {typed}")
    if not whole:
        return number
    if not number.is_integer():
        raise InputError(f"{name} must be a whole number, got {typed}")
    return round(number)
