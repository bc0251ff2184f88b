// The handle of the swipe, on the near end of its line: it is dragged, and as a slider has the arrows.
(function run() {
  const over = document.querySelector('[data-testid=over-canvas]');
  if (!window.gpgrad || !over) { setTimeout(run, 50); return; }
  if (window.gpgrad.acts.swipe) return;
  const handle = over.appendChild(document.createElement('div'));
  handle.dataset.testid = 'swipe-handle';
  handle.style.cssText = 'position:absolute;width:36px;height:36px;margin:-18px;border-radius:50%;' +
    'display:none;align-items:center;justify-content:center;pointer-events:auto;cursor:ew-resize;' +
    'touch-action:none;color:var(--gg-accent);background:var(--gg-bg);border:2px solid currentColor';
  handle.innerHTML = '<span aria-hidden="true">\u25c2\u25b8</span><input type="range" min="0" max="1" ' +
    'step="0.01" aria-label="Swipe" style="position:absolute;opacity:0;pointer-events:none">';
  const slider = handle.querySelector('input');
  let way = [];
  const place = share => {
    const at = share * (way.length - 1), k = Math.min(Math.floor(at), way.length - 2);
    return [0, 1].map(axis => way[k][axis] + (at - k) * (way[k + 1][axis] - way[k][axis]));
  };
  const move = share => {
    const [x, y] = place(share), {left, top} = window.gpgradCanvas;
    slider.value = share;
    handle.style.left = x - left + 'px'; handle.style.top = y - top + 'px';
  };
  gpgrad.acts.swipe = data => {
    way = data.way;
    handle.style.display = way.length ? 'flex' : 'none';
    if (way.length) move('dragged' in handle.dataset ? Number(slider.value) : data.share);
  };
  const go = share => { move(share); gpgrad.say('swipe', {share}, true); };
  slider.oninput = () => go(Number(slider.value));
  slider.onfocus = () => { handle.style.outline = '3px solid var(--mantine-color-text)'; };
  slider.onblur = () => { handle.style.outline = ''; };
  handle.onpointerdown = event => {
    handle.setPointerCapture(event.pointerId); handle.dataset.dragged = ''; slider.focus();
    event.preventDefault();
  };
  handle.onpointermove = event => {
    if (!('dragged' in handle.dataset)) return;
    const box = document.querySelector('canvas').getBoundingClientRect();
    const far = share => {
      const [x, y] = place(share);
      return Math.hypot(x + box.left - event.clientX, y + box.top - event.clientY);
    };
    go([...Array(101).keys()].map(k => k / 100).reduce((a, b) => far(b) < far(a) ? b : a));
  };
  handle.onlostpointercapture = () => { delete handle.dataset.dragged; };
})()
