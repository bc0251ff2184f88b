// The time line: a strip at the foot of the canvas. Python says what stands on it; see
// features/world/timeline.py.
(function run() {
  const over = window.gpgrad && document.querySelector('[data-testid=over-canvas]');
  if (!over) { setTimeout(run, 50); return; }  // the scripts of the canvas may come later
  if (gpgrad.acts.timeline) return;
  const {make} = gpgrad;
  const strip = make(over, 'div', 'position:absolute;left:0;right:0;bottom:var(--gg-gap);height:42px;' +
    'display:none;align-items:center;gap:8px;padding:0 8px;pointer-events:auto;' +
    'background:var(--gg-surface);border:1px solid var(--gg-line);border-radius:12px', {role: 'group', 'aria-label': 'Time line',
    'data-testid': 'timeline'});
  const button = (name, act) => {
    const made = make(strip, 'button', 'all:revert;border:1px solid var(--gg-line);' +
      'border-radius:6px;background:transparent;color:var(--gg-accent);font-family:inherit;' +
      'font-size:13px;line-height:1;min-width:32px;height:32px;flex:none;cursor:pointer', {'aria-label': name, title: name});
    made.onclick = () => gpgrad.say('timeline', act);
    return made;
  };
  const play = button('Play', {act: 'play'});
  const way = make(strip, 'div', 'position:relative;flex:1;min-width:60px;height:32px');
  const marks = make(way, 'div', 'position:absolute;left:8px;right:8px;top:0;height:12px;' +
    'pointer-events:none', {'aria-hidden': 'true', 'data-marks': ''});
  const slider = make(way, 'input', 'position:absolute;left:0;width:100%;bottom:2px;margin:0;' +
    'height:18px;accent-color:var(--gg-accent);cursor:pointer', {type: 'range', min: 0, step: 1,
    'aria-label': 'Time', 'data-testid': 'time'});
  // As large as a finger needs; without its own look, a slider has no size of the thumb.
  const thumb = 'appearance:none;width:24px;height:24px;border:0;border-radius:50%;background:var(--gg-accent)';
  make(over, 'style', '').textContent = '@media (pointer:coarse),(max-width:640px){' +
    '[data-testid=time]{appearance:none;height:24px!important;background:linear-gradient(var(--gg-accent),' +
    'var(--gg-accent)) center/100% 6px no-repeat}[data-marks]{left:12px!important;right:12px!important}' +
    `[data-testid=time]::-webkit-slider-thumb{${thumb}}[data-testid=time]::-moz-range-thumb{${thumb}}}`;
  const words = make(strip, 'div', 'flex:0 1 23em;max-width:40%;overflow:hidden;' +
    'display:-webkit-box;-webkit-box-orient:vertical;-webkit-line-clamp:2;font-size:12px', {'data-testid': 'moment',
    'aria-live': 'polite'});
  const speed = button('Speed', {act: 'speed'});
  const leave = button('Leave the time line', {act: 'leave'});
  leave.textContent = '×';
  // Beside each other, where a moment has several.
  const drawn = {closure: ['▲', 'var(--gg-good)', 0], correction: ['◆', 'var(--gg-accent)', 9],
    refusal: ['✕', 'var(--gg-bad)', -9]};
  let last = '', wanted = null, since = 0;
  slider.oninput = () => {
    wanted = Number(slider.value); since = Date.now();
    gpgrad.say('timeline', {act: 'at', value: wanted}, true);
  };
  gpgrad.acts.timeline = data => {
    strip.style.display = data.shown ? 'flex' : 'none';
    over.style.setProperty('--strip', data.shown ? '52px' : '0px');
    if (!data.shown) return;
    slider.max = Math.max(data.count - 1, 1);
    // What a hand has set stays until it is taken: a busy viewer says older moments meanwhile.
    if (data.at === wanted || Date.now() - since > 5000) wanted = null;
    if (wanted === null) slider.value = data.at;
    const share = 100 * Math.min(data.ready / Math.max(data.count, 1), 1);
    slider.setAttribute('aria-valuetext', data.name ? `submap ${data.name}` : 'the whole drive');
    strip.setAttribute('aria-busy', data.busy);
    way.style.background = data.busy ? 'linear-gradient(currentColor,currentColor) 0 100%/' +
      `${share}% 2px no-repeat` : '';
    play.textContent = data.playing ? '❚❚' : '▶';
    play.title = data.playing ? 'Rest' : 'Play';
    play.setAttribute('aria-label', play.title);
    speed.textContent = data.speed + '×';
    speed.style.display = data.used ? '' : 'none';
    leave.style.display = data.used && !data.live ? '' : 'none';
    const parts = [data.words];
    if (data.busy) parts.push(`comparing ${data.ready} of ${data.count}`);
    words.textContent = parts.filter(part => part).join(' · ');
    words.title = words.textContent;
    strip.dataset.at = data.used ? data.at : '';
    strip.dataset.playing = data.playing; strip.dataset.busy = data.busy;
    strip.dataset.ready = data.ready;
    const now = JSON.stringify([data.marks, data.count]);
    if (now === last) return;
    last = now;
    marks.replaceChildren();
    for (const [number, kind] of data.marks) {
      const [sign, color, aside] = drawn[kind];
      const mark = make(marks, 'span', 'position:absolute;transform:translateX(-50%);' +
        `font-size:12px;line-height:12px;margin-left:${aside}px;` +
        `left:${100 * number / Math.max(data.count - 1, 1)}%;` +
        `color:${color}`, {'data-kind': kind});
      mark.textContent = sign;
    }
  };
  gpgrad.say('timeline', {act: 'here'});
})()
