// Watches the canvas of a page, and writes caption, scale and axes over it. `cover` finds what floats
// over the canvas, and leaves the largest of the strips beside it. What opens for a moment, such as
// a list, does not count.
(function run() {
  if (!window.gpgrad) { setTimeout(run, 50); return; }  // the bridge may come later
  if (window.gpgradCanvas) { window.gpgradCanvas.last = ''; return; }
  const own = window.gpgradCanvas = {last: '', height: 0, left: 0, top: 0, below: 0};
  const make = (parent, style, values) => gpgrad.make(parent, 'div', style, values);
  const ground = 'background:color-mix(in srgb,var(--gg-bg) 78%,transparent);' +
    'border-radius:.35em;padding:.15em .55em;';
  // Where a caption of the scene may lie behind it, only the letters have a ground.
  const halo = 'text-shadow:' + Array(4).fill('0 0 2px var(--gg-bg)') + ';';
  const over = make(document.body, 'position:fixed;pointer-events:none;z-index:1;overflow:hidden;' +
    'container-type:inline-size;color:var(--mantine-color-text);font:13px/1.35 var(--mantine-font-family)');
  over.dataset.testid = 'over-canvas';
  // Where a page was as narrow as a phone, viser may forget how wide its panel was.
  let tries = 0;
  matchMedia('(max-width: 36em)').addEventListener('change', ({matches}) => { tries = matches ? 0 : 20; });
  // What is lit up on the map lies below all that is written.
  const lit = over.appendChild(document.createElementNS('http://www.w3.org/2000/svg', 'svg'));
  lit.dataset.lit = '';
  lit.style.cssText = 'position:absolute;overflow:visible;font:600 13px var(--mantine-font-family)';
  gpgrad.acts.lit = ({drawn, cells}) => {
    lit.style.left = -own.left + 'px'; lit.style.top = -own.top + 'px';
    lit.innerHTML = drawn;
    window.gpgradMatrix?.light(cells);
  };
  gpgrad.acts.theme = theme => window.gpgradTheme.choose(theme);
  const caption = make(over, 'position:absolute;top:calc(10px + var(--head, 0px));left:50%;transform:translateX(-50%);' +
    'max-width:92%;text-align:center;' + ground);
  caption.dataset.testid = 'caption';
  const title = make(caption, 'font-weight:600');
  const line = make(caption, '');
  const scale = make(over, 'position:absolute;left:14px;z-index:1;text-align:center;' +
    'bottom:calc(12px + var(--foot, 0px));' + ground);
  scale.dataset.testid = 'scale';
  const words = make(scale, 'font-variant-numeric:tabular-nums');
  const bar = make(scale, 'height:5px;border:1.5px solid currentColor;border-top:0;' +
    'margin:0 auto 3px');
  const legend = make(over, 'position:absolute;left:50%;transform:translateX(-50%);' +
    'bottom:calc(12px + var(--foot, 0px));' +
    'width:max-content;text-align:center;text-wrap:balance;font-size:.923em;visibility:hidden;' + ground);
  legend.dataset.testid = 'canvas-legend';
  const svg = document.createElementNS('http://www.w3.org/2000/svg', 'svg');
  const frame = make(over, 'position:absolute;right:14px;bottom:calc(12px + var(--foot, 0px));' +
    'padding:.15em .55em;' + halo);
  frame.dataset.testid = 'axes';
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
    const tip = add('path', {d: 'M-5-4 2 0-5 4z', fill: 'currentColor'});
    const label = add('text', {'text-anchor': 'middle', 'dominant-baseline': 'central',
      'font-size': 12, 'font-weight': 600, fill: 'currentColor'});
    return ([x, y], {above, north}) => {
      const long = Math.hypot(x, y) || 1, shown = north && name === 'x' ? 'none' : '';
      label.textContent = north && name === 'y' ? 'N' : name;
      for (const part of [stroke, label]) part.style.display = shown;
      tip.style.display = above ? shown : 'none';
      tip.setAttribute('transform',
        `translate(${12 * x} ${12 * y}) rotate(${Math.atan2(y, x) * 180 / Math.PI})`);
      stroke.setAttribute('x2', 12 * x); stroke.setAttribute('y2', 12 * y);
      label.setAttribute('x', 12 * x + 8 * x / long);
      label.setAttribute('y', 12 * y + 8 * y / long);
    };
  });
  for (const part of [caption, scale, frame]) part.style.visibility = 'hidden';
  gpgrad.acts.caption = data => {
    const spoke = line.textContent !== '';
    title.textContent = data.title; line.textContent = data.line;
    if (spoke !== Boolean(data.line)) own.tell();  // it asks for the page's layout: not at each step
    caption.style.visibility = data.title ? '' : 'hidden';
    const written = JSON.stringify([data.legend, data.frame]);
    if (written !== own.written) {
      own.written = written;
      legend.innerHTML = data.legend || '';
      if (data.frame && !legend.textContent.includes(data.frame)) {
        const remark = make(legend, 'opacity:.85');
        remark.dataset.remark = '';
        remark.textContent = data.frame;
      }
      legend.style.visibility = legend.textContent ? '' : 'hidden';
    }
    own.cursor = data.cursor;
    if (!own.cursor) gpgrad.acts.marks({places: []});
  };
  // A crosshair at the cursor's place and one at the same place of the other submap; between the
  // ends of an association, a line. All of it follows; a card beside the cursor says what is there.
  const cross = 'M0-8a8 8 0 1 0 .01 0M0-13v7M0 13v-7M-13 0h7M13 0h-7';
  const joined = make(over, 'position:absolute;height:0;border-top:2px dashed;' +
    'transform-origin:0 0;filter:drop-shadow(0 0 1px #000);visibility:hidden');
  const crosses = [0, 1].map(() => make(over, 'position:absolute;width:28px;height:28px;' +
    'margin:-14px 0 0 -14px;visibility:hidden'));
  for (const mark of crosses) {
    mark.dataset.testid = 'cursor-mark';
    mark.innerHTML = '<svg aria-hidden="true" width="28" height="28" viewBox="-14 -14 28 28" ' +
      `style="display:block" fill="none"><path d="${cross}" stroke="#000" stroke-width="4.5"/>` +
      `<path d="${cross}" stroke="currentColor" stroke-width="2"/></svg>`;
  }
  const card = make(over, 'position:absolute;left:0;top:0;width:max-content;padding:.4em .7em;' +
    'border-radius:.35em;font-size:13px;font-variant-numeric:tabular-nums;visibility:hidden;' +
    'background:var(--mantine-color-body);box-shadow:0 0 0 1px rgba(128,128,128,.45),' +
    '0 2px 8px rgba(0,0,0,.25)');
  card.dataset.testid = 'hover-card';
  gpgrad.acts.marks = data => {
    const places = own.cursor && !own.still ? data.places.map(
      place => [place[0] - own.left, place[1] - own.top]) : [];
    // Laid onto each other, both submaps have the place where the cursor is.
    if (places[1] && Math.hypot(places[1][0] - places[0][0], places[1][1] - places[0][1]) < 6)
      places.pop();
    crosses.forEach((mark, k) => {
      mark.style.visibility = places[k] ? '' : 'hidden';
      if (!places[k]) return;
      mark.style.color = data.color;
      mark.style.left = places[k][0] + 'px'; mark.style.top = places[k][1] + 'px';
    });
    const line = data.joined && places[1];
    joined.style.visibility = line ? '' : 'hidden';
    if (line) {
      const [[x, y], [u, v]] = places;
      joined.style.color = data.color;
      joined.style.left = x + 'px'; joined.style.top = y + 'px';
      joined.style.width = Math.hypot(u - x, v - y) + 'px';
      joined.style.transform = `rotate(${Math.atan2(v - y, u - x)}rad)`;
    }
    const told = own.cursor && !own.still && data.card && own.at;
    if (told && own.told !== data.card) { own.told = data.card; card.innerHTML = data.card; }
    card.style.visibility = told ? '' : 'hidden';
    if (!told) return;
    const [x, y] = [own.at.x - own.left, own.at.y - own.top];
    const [wide, high] = [card.offsetWidth, card.offsetHeight];
    const left = x + 20 + wide > over.clientWidth ? x - 20 - wide : x + 20;
    const top = y + 20 + high > over.clientHeight ? y - 20 - high : y + 20;
    card.style.left = Math.max(left, 4) + 'px'; card.style.top = Math.max(top, 4) + 'px';
  };
  // By its full name: in an inline handler, the short one is the element's own.
  const at = event => {
    const canvas = document.querySelector('canvas');
    if (!own.cursor || !canvas || !canvas.parentElement.contains(event.target)) return null;
    const box = canvas.getBoundingClientRect();
    return {x: event.clientX - box.left, y: event.clientY - box.top};
  };
  const rest = () => {
    if (!own.still) gpgrad.say('cursor', {x: -9999, y: -9999}, true);  // it points at nothing
    own.still = true; gpgrad.acts.marks({places: []}); gpgrad.acts.lit({drawn: '', cells: {}});
  };
  window.addEventListener('pointermove', event => {
    const place = event.buttons || event.pointerType === 'touch' ? null : at(event);
    if (!place) { if (!own.still) rest(); return; }
    own.still = false; own.at = place;
    gpgrad.say('cursor', place, true);
  });
  window.addEventListener('wheel', rest, {capture: true, passive: true});
  // A click keeps what is there. A drag turns the scene, and Shift is the ruler's.
  window.addEventListener('pointerdown', event => {
    own.pressed = event.button || event.shiftKey ? null : at(event);
  }, true);
  window.addEventListener('pointerup', event => {
    const place = own.pressed && at(event);
    if (place && Math.hypot(place.x - own.pressed.x, place.y - own.pressed.y) < 4)
      gpgrad.say('pin', place);
    own.pressed = null;
  }, true);
  // The verdict is told once: by its card, or here while that is put away. The pair is named once:
  // by its strip (chooser.js), or here.
  own.tell = () => {
    const card = document.querySelector('[data-testid=verdict]');
    const told = card && card.checkVisibility() && card.getClientRects().length;
    line.style.display = line.textContent && !told ? '' : 'none';
    title.style.display = own.named ? 'none' : '';
    caption.style.display = own.named && line.style.display ? 'none' : '';
  };
  // The bar is a share of the canvas's height, so that it is true while the canvas changes.
  own.stretch = () => { bar.style.width = (own.share || 0) * own.height + 'px'; };
  gpgrad.acts.camera = data => {
    own.share = data.share; own.stretch(); words.textContent = data.length;
    // From above they are arrows; of the north alone, where that is known.
    data.axes.forEach((end, k) => axes[k](end, data));
    frame.style.color = data.above ? 'var(--gg-accent)' : '';
    gpgrad.acts.swipe?.(data.swipe);
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
    own.tell();
    if (tries-- > 0 && document.querySelector(VISER_RIGHT_DOCK)?.offsetWidth < PANEL_WIDTH)
      gpgrad.say('wide', {}, true);
    const canvas = document.querySelector('canvas');
    if (!canvas) return;
    const box = canvas.getBoundingClientRect();
    if (box.width < 1 || box.height < 1) return;
    const free = cover(box);
    free.left += window.gpgradMatrix?.dock?.(box, free) ?? 0;  // the matrix beside the picture
    const found = {width: box.width, height: box.height, ...free};
    // The picture stands above the legend. That is nearly as wide on a phone, and above the row of the
    // scale; else it shares that row, which the picture leaves free anyway.
    const narrow = box.width - found.left - found.right < 600;
    const high = box.height - found.top - found.bottom;
    const read = name => parseFloat(over.style.getPropertyValue(name)) || 0;
    const at_foot = innerWidth <= 640 ? read('--pair') : 0;  // on a phone, see chooser.js
    const is_low = high < 450 || at_foot > 0;
    for (const part of legend.querySelectorAll('[data-remark],[data-testid=a-b]'))
      part.style.display = is_low ? 'none' : '';
    legend.style.maxWidth = narrow ? '92%' : 'calc(67% - 84px)';  // beside the scale
    // Where the legend is as wide as the row of scale and axes; these are higher.
    const over_axes = legend.offsetLeft + legend.offsetWidth / 2 > frame.offsetLeft - 8;
    const lift = narrow && !is_low ? over_axes ? 56 : 40 : 0;
    // In a narrow and low canvas only the colour bar stands beside the scale, and words above it.
    const beside = 2 * (scale.offsetLeft + scale.offsetWidth + 8);
    legend.style.setProperty('--bar', narrow && !lift && !document.body.dataset.story ? over.clientWidth - beside + 'px' : '100%');
    legend.style.bottom = `calc(${12 + lift}px + var(--foot, 0px))`;
    const told = legend.style.visibility === '' ? legend.offsetHeight : 0;
    const covered = at_foot + (told && told + (narrow ? lift : read('--strip') - 60));
    // With fewer words in the legend the picture stays as large as it was.
    const size = JSON.stringify(found);
    own.below = own.size === size ? Math.max(own.below, covered) : covered;
    own.size = size;
    const {below} = own, head = narrow && !at_foot ? read('--pair') : 0;
    const dark = document.documentElement.dataset.mantineColorScheme === 'dark';
    const now = JSON.stringify([found, below, head, dark]);
    if (now === own.last) return;
    own.last = now;
    own.height = box.height; own.left = found.left; own.top = found.top; own.stretch();
    over.style.left = box.left + found.left + 'px'; over.style.top = box.top + found.top + 'px';
    over.style.width = box.width - found.left - found.right + 'px';
    over.style.height = box.height - found.top - found.bottom + 'px';
    gpgrad.say('canvas', {...found, top: found.top + head, below, dark}, true);
  }, 200);
})()
