// Puts thumbs and marks of sliders where they belong on a scale of equal factors. What a slider's own
// listeners would do with the same event must not happen: this script hears it first, and goes no
// further with it. `whole` says whether a slider has whole numbers only.
(sliders => {
  if (!window.gpgradDecades) {
    const known = window.gpgradDecades = new Map();
    const KEY = 1.05, PAGE = 1.5;
    let held = null;
    const find = at => {
      const root = at && at.closest && at.closest(VISER_SLIDER);
      return root && known.has(root.id) ? root : null;
    };
    const read = root => {
      const thumb = root.querySelector('[role=slider]');
      const [low, high, now] = ['min', 'max', 'now'].map(
        name => +thumb.getAttribute('aria-value' + name));
      return {thumb, low, high, now, off: thumb.getAttribute('aria-disabled') === 'true'};
    };
    const share = (value, {low, high}) =>
      100 * Math.log(Math.min(Math.max(value, low), high) / low) / Math.log(high / low);
    const place = root => {
      const slider = read(root);
      if (!(slider.low > 0 && slider.high > slider.low)) return;
      const put = (part, name, value) => part && part.style.setProperty(name, value, 'important');
      const at = share(slider.now, slider);
      put(slider.thumb, 'left', at + '%');
      put(root.querySelector(VISER_SLIDER_BAR), 'width',
        `calc(${at}% + 2 * var(--slider-size))`);
      for (const mark of root.querySelectorAll(VISER_SLIDER_MARK)) {
        const linear = parseFloat(mark.style.getPropertyValue('--mark-offset')) / 100;
        const value = slider.low + linear * (slider.high - slider.low);
        put(mark, 'inset-inline-start',
          `calc(${share(value, slider)}% - var(--slider-size) / 2)`);
      }
    };
    const set = (root, value) => {
      const {low, high} = read(root), whole = known.get(root.id);
      const kept = Math.min(Math.max(+value.toPrecision(DIGITS), low), high);
      const box = root.parentElement.querySelector(VISER_TYPED_BOX);
      const text = String(whole ? Math.round(kept) : kept);
      if (!box || box.value === text) return;
      // The box takes the focus when its number changes, and a phone would bring its keyboard up.
      box.focus = () => {};
      box.setSelectionRange = (...ends) => {
        if (document.activeElement !== box) return;
        HTMLInputElement.prototype.setSelectionRange.apply(box, ends);
      };
      Object.getOwnPropertyDescriptor(HTMLInputElement.prototype, 'value').set.call(box, text);
      box.dispatchEvent(new Event('input', {bubbles: true}));
    };
    const drag = event => {
      const track = held.querySelector(VISER_SLIDER_TRACK).getBoundingClientRect();
      const at = (event.touches ? event.touches[0] : event).clientX;
      const {low, high} = read(held);
      set(held, low * (high / low) ** Math.min(Math.max((at - track.left) / track.width, 0), 1));
    };
    const take = event => { event.stopPropagation(); event.preventDefault(); };
    const grab = event => {
      const root = find(event.target);
      if (!root || event.button) return;
      take(event);
      const slider = read(root);
      if (slider.off) return;
      slider.thumb.focus({preventScroll: true});
      held = root;
      document.documentElement.dataset.sliderHeld = '';
      drag(event);
    };
    const release = () => { held = null; };
    document.addEventListener('pointerover', event => {  // the hand looks at the picture until then
      if (!held && !find(event.target)) delete document.documentElement.dataset.sliderHeld;
    }, {passive: true});
    const options = {capture: true, passive: false};
    for (const name of ['mousedown', 'touchstart']) document.addEventListener(name, grab, options);
    for (const name of ['mousemove', 'touchmove']) {
      document.addEventListener(name, event => {
        if (held && held.isConnected && (event.touches || event.buttons & 1)) drag(event);
        else if (held) release();
      });
    }
    for (const name of ['mouseup', 'touchend', 'touchcancel']) {
      window.addEventListener(name, release, true);
    }
    document.addEventListener('keydown', event => {
      const root = event.target.getAttribute?.('role') === 'slider' ? find(event.target) : null;
      if (!root || event.ctrlKey || event.metaKey || event.altKey) return;
      const slider = read(root);
      const factor = {ArrowRight: KEY, ArrowUp: KEY, ArrowLeft: 1 / KEY, ArrowDown: 1 / KEY,
        PageUp: PAGE, PageDown: 1 / PAGE, Home: 0, End: Infinity}[event.key];
      if (factor === undefined) return;
      take(event);
      if (slider.off) return;
      let to = Math.min(Math.max(slider.now * factor, slider.low), slider.high);
      if (known.get(root.id)) to = factor > 1 ? Math.ceil(to) : Math.floor(to);
      set(root, to);
    }, true);
    new MutationObserver(changes => {
      for (const {type, target, addedNodes} of changes) {
        if (type === 'attributes') { if (find(target)) place(find(target)); continue; }
        for (const added of addedNodes) {
          if (!added.querySelectorAll) continue;
          for (const root of [added, ...added.querySelectorAll(VISER_SLIDER)]) {
            if (known.has(root.id)) place(root);
          }
        }
      }
    }).observe(document.body, {subtree: true, childList: true, attributes: true,
      attributeFilter: ['aria-valuenow', 'aria-valuemin', 'aria-valuemax']});
    window.gpgradDecades.place = place;
  }
  for (const [id, whole] of Object.entries(sliders)) {
    window.gpgradDecades.set(id, whole);
    const root = document.getElementById(id);
    if (root) window.gpgradDecades.place(root);
  }
})(SLIDERS)
