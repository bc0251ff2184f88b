// Writes what a demonstration tells as a large lower third, and leaves nothing else but the canvas
// and its legend. While it runs, the arrows go a step on or back, as the keys of a presenter do;
// otherwise they would fly the camera too.
(function run() {
  if (!window.gpgrad) { setTimeout(run, 50); return; }  // the bridge may come later
  if (window.gpgrad.acts.story) return;
  const style = document.head.appendChild(document.createElement('style'));
  // Letters grow with the screen. Words stand at the left of a band at the foot, legend and scale at
  // its right; the camera keeps the picture above it.
  style.textContent = LOWER_THIRD + `body[data-bare] :is(${VISER_ROOT} > :not(:has(canvas)),${VISER_PANEL}:has([data-testid=mode])){visibility:hidden!important}
body[data-bare] ${VISER_ROOT} > :has(canvas){inset:0!important}
body[data-bare] #gpgrad-opening{display:none}
body[data-bare] [data-testid=over-canvas]{font-size:clamp(13px,1.9vmin,44px)!important}
body[data-bare] [data-testid=no-graphics-card]{display:none}
body[data-story] :is([data-testid=caption],[data-testid=pair-strip],[data-testid=axes],[data-remark]){display:none!important}
body[data-story] [data-testid=canvas-legend]{left:auto!important;right:4vw;transform:none!important;
bottom:calc(4vmin + 3.4em)!important;max-width:34vw!important;font-size:clamp(12px,2vmin,44px)!important}
body[data-story] [data-testid=scale]{left:auto!important;right:4vw;bottom:4vmin!important;font-size:clamp(12px,2vmin,44px)}
@media (max-width:640px){body[data-story] [data-testid=canvas-legend]{bottom:auto!important;top:4vmin;max-width:92vw!important}}
[data-testid=leave]{all:unset;position:fixed;right:1rem;top:1rem;z-index:4;width:2.6rem;height:2.6rem;border-radius:50%;
text-align:center;font:1.1rem/2.6rem sans-serif;cursor:pointer;opacity:0;transition:opacity .3s;display:none;
color:var(--mantine-color-text);background:color-mix(in srgb,var(--mantine-color-body) 80%,#888)}
body[data-bare] [data-testid=leave]{display:block}[data-testid=leave]:is([data-near],:focus-visible){opacity:1}`;
  const part = (tag, name, parent) => {
    const made = parent.appendChild(document.createElement(tag));
    if (name) made.dataset.testid = name;
    return made;
  };
  const third = part('div', 'lower-third', document.body);
  third.className = 'gg-third'; third.setAttribute('aria-live', 'polite');
  third.style.visibility = 'hidden';
  const [title, line, dots] = [0, 1, 2].map(() => part('div', '', third));
  dots.style.cssText = 'display:flex;gap:.35em;margin-top:.75em;align-items:center;font-size:.8em';
  // A finger has no Esc: the way back comes with whatever moves.
  const leave = part('button', 'leave', document.body);
  leave.textContent = '\u2715'; leave.title = 'Back (Esc)'; leave.setAttribute('aria-label', 'Leave full screen');
  const press = (key, kind = 'keydown') => document.documentElement.dispatchEvent(
    new KeyboardEvent(kind, {key, code: key, bubbles: true, cancelable: true}));
  leave.onclick = () => press('Escape');
  let fading;
  window.addEventListener('pointermove', () => {
    leave.dataset.near = ''; clearTimeout(fading);
    fading = setTimeout(() => { delete leave.dataset.near; }, 1800);
  });
  gpgrad.acts.full = data => { document.body.toggleAttribute('data-bare', data.on); };
  gpgrad.acts.story = data => {
    third.style.visibility = data.title ? '' : 'hidden';
    if (!data.title) { delete document.body.dataset.story; return; }
    document.body.dataset.story = data.going ? 'going' : 'resting';
    title.textContent = data.title; line.textContent = data.line;
    dots.replaceChildren(...Array.from({length: data.count}, (_, k) => {
      const dot = document.createElement('span');
      dot.style.cssText = 'width:1.7em;height:.28em;border-radius:1em;background:' +
        (k === data.step ? 'var(--gg-accent);' : 'currentColor;') +
        `opacity:${k === data.step ? 1 : .22}`;
      return dot;
    }));
    if (!data.going) dots.append('paused');
  };
  const keys = {ArrowRight: 'PageDown', ArrowLeft: 'PageUp'};
  for (const kind of ['keydown', 'keyup']) {
    window.addEventListener(kind, event => {
      const key = keys[event.key];
      if (!key || !document.body.dataset.story) return;
      event.preventDefault(); event.stopImmediatePropagation();
      press(key, kind);
    }, true);
  }
})()
