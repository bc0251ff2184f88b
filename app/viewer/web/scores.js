// One threshold on the scores of all pairs. It follows the hand at once, and the server's value
// later: `say` tells the server, `settle` takes what it answers, and `place` draws.
(() => {
  const state = window.gpgradScore = window.gpgradScore ||
    {value: null, dragging: null, sent: null, until: 0};
  state.say = value => {
    state.value = state.sent = value;
    state.until = Date.now() + 2000;
    state.place();
    gpgrad.say('threshold', {score: value}, true);
  };
  state.rest = () => {
    if (state.sent !== null) gpgrad.say('threshold', {score: state.sent, rested: true});
  };
  state.place = () => {
    for (const svg of document.querySelectorAll('[data-scores]')) {
      const d = svg.dataset, points = svg.points || (svg.points = JSON.parse(d.points));
      const value = state.value ?? +d.value;
      const x = +d.left + Math.min(Math.max(value / d.high, 0), 1) * d.span;
      svg.querySelector('[data-threshold]').setAttribute('transform', `translate(${x} 0)`);
      const text = svg.querySelector('[data-number]');
      text.textContent = value.toFixed(1);
      text.setAttribute('text-anchor', value > d.high / 2 ? 'end' : 'start');
      text.setAttribute('x', value > d.high / 2 ? -5 : 5);
      svg.setAttribute('aria-valuenow', value);
      const dot = svg.querySelector('[data-dot]');
      if (!dot) continue;
      let last = null;
      for (const point of points) if (point[0] >= value) last = point;
      dot.setAttribute('visibility', last ? 'visible' : 'hidden');
      if (last) { dot.setAttribute('cx', last[1]); dot.setAttribute('cy', last[2]); }
    }
  };
  state.settle = value => {
    state.latest = value;
    if (state.dragging) return;
    if (Date.now() < state.until && Math.abs(value - state.sent) > 1e-6) {
      setTimeout(() => state.settle(state.latest), state.until - Date.now() + 10);
      return;
    }
    state.value = value;
    state.place();
  };
  state.read = event => {
    const svg = document.querySelector('[data-scores]');
    if (!svg) return;
    const d = svg.dataset, points = svg.points || (svg.points = JSON.parse(d.points));
    const at = gpgrad.place(svg, event);
    let value = (at.x - d.left) / d.span * d.high;
    if (state.dragging === 'curve' && points.length)
      value = points.reduce((a, b) => Math.abs(b[1] - at.x) < Math.abs(a[1] - at.x) ? b : a)[0];
    const step = +d.step;
    value = Math.min(Math.max(Math.floor(value / step + 1e-6) * step, +d.low), +d.most);
    if (state.dragging !== 'curve') value = Math.min(value, +d.high);
    state.say(+value.toFixed(6));
  };
  state.grab = event => {
    const svg = event.currentTarget;
    const at = gpgrad.place(svg, event);
    state.dragging = at.y > +svg.dataset.curve ? 'curve' : 'bars';
    event.preventDefault();
    svg.focus({preventScroll: true});
    const move = moved => { if (state.dragging) state.read(moved); };
    const up = () => {
      state.dragging = null;
      window.removeEventListener('pointermove', move);
      window.removeEventListener('pointerup', up);
      window.removeEventListener('pointercancel', up);
      state.rest();
    };
    window.addEventListener('pointermove', move);
    window.addEventListener('pointerup', up);
    window.addEventListener('pointercancel', up);
    state.read(event);
  };
  state.key = event => {
    const by = {ArrowLeft: -1, ArrowDown: -1, ArrowRight: 1, ArrowUp: 1}[event.key];
    if (!by) return;
    event.preventDefault();
    event.stopPropagation();
    const d = event.currentTarget.dataset, now = state.value ?? +d.value;
    state.say(+Math.min(Math.max(now + by * d.step, +d.low), +d.most).toFixed(6));
    state.rest();
  };
  // The marks of the pairs that are wrong or missed.
  const markAt = (svg, event) => {
    const at = gpgrad.place(svg, event);
    const marks = svg.marks || (svg.marks = JSON.parse(svg.dataset.marks));
    let best = null;
    for (const mark of marks)
      if (!best || Math.abs(mark[0] - at.x) < Math.abs(best[0] - at.x)) best = mark;
    return best && Math.abs(best[0] - at.x) < 12 ? best : null;
  };
  state.point = (svg, event) => {
    const mark = markAt(svg, event), said = svg.nextElementSibling;
    svg.style.cursor = mark ? 'pointer' : 'default';
    said.textContent = mark ? mark[3] : said.dataset.said;
  };
  state.open = (svg, event) => {
    const mark = markAt(svg, event);
    if (mark) gpgrad.say('open-pair', {query: mark[1], database: mark[2]});
  };
  state.place();
})()
