// Keeps number boxes to itself while a person types, says where sliders come to rest, and puts chips
// onto boxes, strips below sliders, and thumbs where they belong on a scale of equal factors. What a page's own listeners
// would do with the same event must not happen: this script hears it first, and goes no further with
// it. `typing` is the box in which a person types, and `said` are the boxes that wait to be answered;
// both know what viser has written there. `gpgradSliders` comes with each change of it: which sliders
// span decades, whether their numbers are whole, the chips, and the strips.
(function run() {
  if (!window.gpgrad) { setTimeout(run, 50); return; }  // the bridge may come later
  if (window.gpgradNumbers) return;
  window.gpgradSliders ??= {decades: {}, chips: {}, strips: {}};
  const KEY = 1.05, PAGE = 1.5;
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
  const read = ({slider, box}) => {
    const thumb = slider?.querySelector('[role=slider]');
    if (!thumb) return {now: parseFloat(box.value)};
    const [low, high, now] = ['min', 'max', 'now'].map(
      name => +thumb.getAttribute('aria-value' + name));
    return {thumb, low, high, now, off: thumb.getAttribute('aria-disabled') === 'true'};
  };
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
    if (!found || event.ctrlKey || event.metaKey || event.altKey) return;
    if (!isBox) return multiply(found, event);
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
  const note = () => {
    if (!resting) return;
    const {id, was} = resting, value = read(resting).now;
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
    pressed = found && {...found, was: read(found).now};
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
    if (!found || event.target === found.box) return;
    press(found);
    if (!isSpread(found.slider) || !found.slider.contains(event.target) || event.button) return;
    take(event);
    const {off, thumb} = read(found);
    if (off) return;
    thumb.focus({preventScroll: true});
    held = found;
    document.documentElement.dataset.sliderHeld = '';
    drag(event);
  });
  for (const name of ['mousemove', 'touchmove']) {  // which may not keep a page from scrolling
    window.addEventListener(name, event => {
      if (held?.slider.isConnected && (event.touches || event.buttons & 1)) drag(event);
      else held = null;
    }, true);
  }
  hear(['mouseup', 'touchend', 'touchcancel'], () => { held = null; letGo(); });
  hear(['pointerover'], event => {  // the hand looks at the picture until then
    if (!held && !isSpread(find(event.target)?.slider)) {
      delete document.documentElement.dataset.sliderHeld;
    }
  });
  hear(['keyup'], event => { if (MOVING.test(event.key)) letGo(); });

  // Sliders over decades.
  let held = null;
  const isSpread = slider => slider && slider.id in gpgradSliders.decades;
  const take = event => { event.stopPropagation(); event.preventDefault(); };
  const shareOn = (slider, low, high) => {  // [%]
    const at = isSpread(slider) ? Math.log : value => value;
    return value => 100 * (at(Math.min(Math.max(value, low), high)) - at(low)) / (at(high) - at(low));
  };
  const spread = found => {
    const {thumb, low, high, now} = read(found), {slider} = found;
    if (!(low > 0 && high > low)) return;
    const share = shareOn(slider, low, high);
    const style = (part, name, value) => part?.style.setProperty(name, value, 'important');
    style(thumb, 'left', share(now) + '%');
    style(slider.querySelector(VISER_SLIDER_BAR), 'width',
      `calc(${share(now)}% + 2 * var(--slider-size))`);
    for (const mark of slider.querySelectorAll(VISER_SLIDER_MARK)) {
      const linear = parseFloat(mark.style.getPropertyValue('--mark-offset')) / 100;
      style(mark, 'inset-inline-start',
        `calc(${share(low + linear * (high - low))}% - var(--slider-size) / 2)`);
    }
  };
  const set = (found, value) => {
    const {box, id} = found, {low, high} = read(found);
    const kept = Math.min(Math.max(+value.toPrecision(DIGITS), low), high);
    const text = String(gpgradSliders.decades[id] ? Math.round(kept) : kept);
    if (box.value === text) return;
    // The box takes the focus when its number changes, and a phone would bring its keyboard up.
    box.focus = () => {};
    box.setSelectionRange = (...ends) => {
      if (document.activeElement !== box) return;
      HTMLInputElement.prototype.setSelectionRange.apply(box, ends);
    };
    put(box, text);
    box.dispatchEvent(new Event('input', {bubbles: true}));
  };
  const drag = event => {
    const track = held.slider.querySelector(VISER_SLIDER_TRACK).getBoundingClientRect();
    const at = (event.touches ? event.touches[0] : event).clientX, {low, high} = read(held);
    set(held, low * (high / low) ** Math.min(Math.max((at - track.left) / track.width, 0), 1));
  };
  const multiply = (found, event) => {
    const factor = {ArrowRight: KEY, ArrowUp: KEY, ArrowLeft: 1 / KEY, ArrowDown: 1 / KEY,
      PageUp: PAGE, PageDown: 1 / PAGE, Home: 0, End: Infinity}[event.key];
    if (factor === undefined || !isSpread(found.slider)) return;
    const {thumb, low, high, now, off} = read(found);
    if (event.target !== thumb) return;
    take(event);
    if (off) return;
    const to = Math.min(Math.max(now * factor, low), high);
    const whole = gpgradSliders.decades[found.id];
    set(found, whole ? (factor > 1 ? Math.ceil(to) : Math.floor(to)) : to);
  };

  const putChip = ({box, id}, {word, hint, back}) => {
    const field = box.closest(VISER_NUMBER_FIELD), kind = back ? 'BUTTON' : 'SPAN';
    let chip = field.querySelector('[data-chip]');
    if (chip && chip.tagName !== kind) { chip.remove(); chip = null; }
    if (!chip) {
      chip = field.appendChild(document.createElement(kind));
      if (back) {
        chip.type = 'button';
        chip.addEventListener('click', () => gpgrad.say('way-back', {widget: id}));
      }
    }
    if (chip.dataset.chip === word && chip.title === hint) return;
    chip.dataset.chip = chip.textContent = word;
    chip.title = hint;
    if (back) chip.setAttribute('aria-label', hint);
  };
  const putStrip = (found, strip) => {
    const {low, high, now} = read(found), share = shareOn(found.slider, low, high);
    const track = found.slider.querySelector(VISER_SLIDER_TRACK), {edges, accepted} = strip;
    let shown = track.querySelector('[data-strip]');
    if (!shown) shown = track.appendChild(document.createElement('div'));
    const drawn = JSON.stringify([strip, low, high]);
    if (shown.dataset.strip !== drawn) {
      shown.dataset.strip = drawn;
      shown.title = strip.hint;
      shown.classList.toggle('stale', strip.stale);
      shown.innerHTML = accepted.map((yes, k) => {
        const left = share(edges[k]), width = share(edges[k + 1]) - left;
        return `<i class="${yes ? 'yes' : 'no'}" style="left:${left}%;width:${width}%"></i>`;
      }).join('') + '<b></b>';
    }
    shown.lastChild.style.left = share(now) + '%';
  };
  // viser builds a slider anew when its folder opens.
  window.gpgradNumbers = () => {
    const {decades, chips, strips} = gpgradSliders;
    for (const stale of document.querySelectorAll('[data-strip]')) {
      if (!(stale.closest(VISER_SLIDER)?.id in strips)) stale.remove();
    }
    for (const id of new Set([decades, chips, strips].flatMap(Object.keys))) {
      const found = find(document.getElementById(id));
      if (found && id in decades) spread(found);
      if (found && id in chips) putChip(found, chips[id]);
      if (found && id in strips) putStrip(found, strips[id]);
    }
  };
  gpgradNumbers();
  gpgrad.say('sliders');
  new MutationObserver(gpgradNumbers).observe(document.body, {subtree: true, childList: true,
    attributes: true, attributeFilter: ['aria-valuenow', 'aria-valuemin', 'aria-valuemax']});
})()
