// Watches the canvas of a page, and writes caption, scale and axes over it. `cover` finds what floats
// over the canvas, and leaves the largest of the strips beside it. What opens for a moment, such as
// a list, does not count.
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
    const seen = [...document.querySelectorAll(VISER_PANEL)].filter(one => {
      const style = getComputedStyle(one), box = one.getBoundingClientRect();
      return (style.position === 'absolute' || style.position === 'fixed') && box.width > 150 &&
        box.height > 60 && style.visibility !== 'hidden' && !one.closest(
          `[role=dialog],[role=listbox],[role=alert],${VISER_NOTIFICATIONS},${VISER_DROPDOWN},${VISER_TOOLTIP}`);
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
