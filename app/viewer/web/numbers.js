// Keeps number boxes to itself while a person types, and says where sliders come to rest. What a
// page's own listeners would do with what is typed must not happen: this script hears it first, and
// goes no further with it. Scripts that set a box, as that of the decades does, are let through.
// `typing` is the box in which a person types, and `said` are the boxes that wait to be answered;
// both know what viser has written there.
(function run() {
  if (!window.gpgrad) { setTimeout(run, 50); return; }  // the bridge may come later
  if (window.gpgradNumbers) return;
  window.gpgradNumbers = true;
  const MOVING = /^(Arrow(Up|Down|Left|Right)|Page(Up|Down)|Home|End)$/;
  const find = at => {
    const part = at && at.closest && at.closest(`${VISER_SLIDER},${VISER_NUMBER_FIELD}`);
    if (!part) return null;
    const isField = part.matches(VISER_NUMBER_FIELD);
    const beside = isField ? part.previousElementSibling : part.nextElementSibling;
    const slider = isField ? (beside?.matches(VISER_SLIDER) ? beside : null) : part;
    const field = isField ? part : (beside?.matches(VISER_NUMBER_FIELD) ? beside : null);
    const box = field && field.querySelector(VISER_TYPED_BOX);
    return box && {id: (slider || box).id, slider, box};
  };
  const put = (box, text) =>
    Object.getOwnPropertyDescriptor(HTMLInputElement.prototype, 'value').set.call(box, text);
  let typing = null, whole = null;
  const said = new Map();
  const commit = () => {
    const {id, box, before, text} = typing;
    typing = null;
    if (text === before) return;
    rest();
    put(box, text);
    said.set(id, {box, before, text});
    gpgrad.say('typed', {widget: id, text});
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
  // A value that comes takes the selection away. Where all of a box was selected, it is so again at
  // the next key: else what is typed would stand behind the new value, in place of the old one.
  hear(['select', 'selectionchange'], () => {
    const box = document.activeElement, {selectionStart: start, selectionEnd: end, value} = box;
    if (value && find(box)?.box === box && end - start === value.length) whole = {box, text: value};
  });
  const selectAgain = box => {
    if (whole?.box !== box || box.value === whole.text) return;
    if (typing?.box === box) {
      typing.before = box.value;
      put(box, typing.text);
    }
    box.select();
  };
  hear(['mousedown', 'touchstart', 'input', 'focusout'], () => { whole = null; });
  hear(['beforeinput', 'input', 'change', 'paste'], event => {
    const found = event.isTrusted && find(event.target);
    if (!found || event.target !== found.box) return;
    event.stopImmediatePropagation();
    const {box} = found;
    if (event.type === 'beforeinput') {
      if (typing?.box !== box) {
        typing = {...found, before: said.get(found.id)?.before ?? box.value, text: box.value};
      } else if (box.value !== typing.text) {
        // A busy page shows a value only now, over what is typed, which goes on after it.
        typing.before = box.value;
        put(box, typing.text);
      }
    }
    if (event.type === 'input' && typing?.box === box) typing.text = box.value;
  });
  hear(['focusout'], event => {
    if (typing?.box !== event.target) return;
    event.stopImmediatePropagation();
    commit();
  });
  hear(['keydown'], event => {
    const found = find(event.target), isBox = found && found.box === event.target;
    if (isBox) selectAgain(found.box);
    if (MOVING.test(event.key) || /^(Enter|Escape)$/.test(event.key)) whole = null;
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
