// Writes what a demonstration tells as a large lower third, and leaves nothing else but the canvas
// and its legend. While it runs, the arrows go a step on or back, as the keys of a presenter do;
// otherwise they would fly the camera too.
(function run() {
  if (!window.gpgrad) { setTimeout(run, 50); return; }  // the bridge may come later
  if (window.gpgrad.acts.story) return;
  const style = document.head.appendChild(document.createElement('style'));
  style.textContent = `body[data-story] :is(${VISER_PANEL},${VISER_DOCK},${VISER_DOCK_REGION},${VISER_DOCK_COLLAPSE})` +
    '{visibility:hidden!important}body[data-story] :is([data-testid=caption],[data-testid=pair-strip]){display:none!important}';
  const third = document.createElement('div');
  third.dataset.testid = 'lower-third';
  third.setAttribute('aria-live', 'polite');
  third.style.cssText = 'position:fixed;left:4vw;bottom:76px;max-width:min(72vw,60em);z-index:3;' +
    'pointer-events:none;visibility:hidden;padding:.5em 1em .6em;border-left:6px solid var(--gg-accent);' +
    'border-radius:.3em;color:var(--mantine-color-text);font-family:var(--mantine-font-family);' +
    'background:color-mix(in srgb,var(--mantine-color-body) 86%,transparent)';
  const add = css => {
    const made = third.appendChild(document.createElement('div'));
    made.style.cssText = css;
    return made;
  };
  const title = add('font-weight:700;font-size:clamp(22px,3vw,52px);line-height:1.15');
  const line = add('font-size:clamp(15px,1.5vw,26px);line-height:1.35;margin-top:.25em');
  const dots = add('display:flex;gap:7px;margin-top:.7em;align-items:center');
  document.body.appendChild(third);
  gpgrad.acts.story = data => {
    third.style.visibility = data.title ? '' : 'hidden';
    if (!data.title) { delete document.body.dataset.story; return; }
    document.body.dataset.story = data.going ? 'going' : 'resting';
    title.textContent = data.title; line.textContent = data.line;
    dots.replaceChildren(...Array.from({length: data.count}, (_, k) => {
      const dot = document.createElement('span');
      dot.style.cssText = 'width:28px;height:5px;border-radius:3px;background:currentColor;' +
        `opacity:${k === data.step ? 1 : .25}`;
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
      document.documentElement.dispatchEvent(
        new KeyboardEvent(kind, {key, code: key, bubbles: true, cancelable: true}));
    }, true);
  }
})()
