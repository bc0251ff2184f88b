// The matrix of all pairs: which cell the mouse or the keys are on, what it says, and what a click
// tells. A small picture carries the texts of its cells along; of a large one the server says them.
// That one lies beside what the canvas shows: the wheel enlarges it, and a drag moves it.
window.gpgradMatrix = window.gpgradMatrix || {
  ASKED: '…',  // what a cell holds, until the server says it
  cell(svg, event) {
    const at = gpgrad.place(svg, event), d = svg.dataset;
    return this.read(svg, Math.floor((at.y - d.top) / d.side), Math.floor((at.x - d.left) / d.side));
  },
  read(svg, row, column) {
    const d = svg.dataset, cells = svg.cells || (svg.cells = JSON.parse(d.cells));
    const inside = row >= 0 && column >= 0 && row < +d.rows && column < +d.columns;
    const text = +d.asks ? this.ASKED :
      cells[row + ',' + column] || (+d.mirrored && cells[column + ',' + row]);
    return {row, column, text: inside ? text : undefined};
  },
  move(svg, event) {
    if (event.buttons && +svg.dataset.asks) this.pan(svg, event);
    else this.point(svg, this.cell(svg, event));
  },
  point(svg, cell) {
    this.mark(svg, cell);
    svg.style.cursor = cell.text ? 'pointer' : 'default';
    const now = cell.text ? [cell.row, cell.column] : [-1, -1];
    if (String(svg.now ?? [-1, -1]) === String(now)) return;
    svg.now = now;
    gpgrad.say('cell', {name: svg.dataset.name, row: now[0], column: now[1]}, true);
  },
  mark(svg, {row = 0, column = 0, text}) {
    const d = svg.dataset, spot = svg.querySelector('[data-spot]');
    this.write(svg, text);
    spot.setAttribute('visibility', text ? 'visible' : 'hidden');
    spot.setAttribute('x', +d.left + column * d.side);
    spot.setAttribute('y', +d.top + row * d.side);
  },
  write(svg, text) {
    const said = svg.parentElement.querySelector('[data-said]');
    if (text !== this.ASKED) said.textContent = text || said.dataset.said;
  },
  // Marks the cells of what the map lights up; what the mouse or the keys are on stays marked.
  light(cells) {
    for (const svg of document.querySelectorAll('svg[data-cells]')) {
      const [row, column, text] = cells[svg.dataset.name] ?? [];
      if (svg.now?.[0] >= 0) this.write(svg, text); else this.mark(svg, {row, column, text});
    }
  },
  leave(svg) { this.point(svg, {}); },
  click(svg, event) {
    const {row, column, text} = this.cell(svg, event);
    if (text && !svg.panned) gpgrad.say('matrix', {name: svg.dataset.name, row, column});
    svg.panned = false;
  },
  key(svg, event) {
    const by = {ArrowLeft: [0, -1], ArrowRight: [0, 1], ArrowUp: [-1, 0], ArrowDown: [1, 0]}[event.key];
    const [row, column] = svg.now?.[0] >= 0 ? svg.now : [1, 0], d = svg.dataset;
    if (by) this.point(svg, this.read(svg, Math.min(Math.max(row + by[0], 0), d.rows - 1),
      Math.min(Math.max(column + by[1], 0), d.columns - 1)));
    else if (event.key === 'Enter') gpgrad.say('matrix', {name: d.name, row, column});
    else return;
    event.preventDefault(); event.stopPropagation();  // it would fly the camera too
  },
  pan(svg, {movementX, movementY}) {
    const {x, y, width, height} = svg.viewBox.baseVal, scale = svg.getScreenCTM().a;
    if (width >= svg.whole.width) return;
    svg.panned ||= Math.hypot(movementX, movementY) > 2;
    this.view(svg, x - movementX / scale, y - movementY / scale, width, height);
  },
  zoom(svg, event) {
    event.preventDefault();
    const {x, y, width, height} = svg.viewBox.baseVal, at = gpgrad.place(svg, event);
    const least = Math.min(8 * svg.dataset.side / svg.whole.width, 1);
    const share = Math.min(Math.max(width / svg.whole.width * 1.0015 ** event.deltaY, least), 1);
    const by = share * svg.whole.width / width;
    this.view(svg, at.x - (at.x - x) * by, at.y - (at.y - y) * by, width * by, height * by);
  },
  view(svg, x, y, width, height) {
    const {whole} = svg, within = (low, most) => Math.min(Math.max(low, 0), most);
    svg.setAttribute('viewBox', [within(x, whole.width - width), within(y, whole.height - height),
      width, height].join(' '));
  },
  // Puts the board of a page's HTML over its canvas, in place of the one before; null takes it away.
  show(part) {
    const before = this.board, board = this.board = part?.querySelector('[data-board]') ?? null;
    const [was, svg] = [before, board].map(one => one?.querySelector('svg[data-asks]'));
    before?.remove();
    if (!board) { gpgrad.acts.lit({drawn: '', cells: {}}); return; }
    document.body.append(board);
    if (before) board.style.cssText = before.style.cssText;
    if (!svg) return;
    const {width, height} = svg.viewBox.baseVal;
    svg.whole = {width, height};
    svg.addEventListener('wheel', event => this.zoom(svg, event), {passive: false});
    if (was?.dataset.rows === svg.dataset.rows)
      svg.setAttribute('viewBox', was.getAttribute('viewBox'));
  },
  // Says how many pixels of a canvas it takes, beside what else covers that.
  dock(canvas, free) {
    if (!this.board?.isConnected) return 0;
    const wide = canvas.width - free.left - free.right, high = canvas.height - free.top - free.bottom;
    const is_phone = wide < 540;  // where both have no room beside each other
    const width = is_phone ? wide :
      Math.round(Math.min(Math.max(Math.min(0.58 * wide, high - 165), 340), wide - 300));
    Object.assign(this.board.style, {left: canvas.left + free.left + 'px', width: width - 16 + 'px',
      top: canvas.top + free.top + 'px', maxHeight: high - 16 + 'px'});
    return is_phone ? 0 : width;
  },
};
