// The matrix of all pairs: which cell the mouse is on, what it says, and what a click tells. The
// picture carries the texts of its cells along, and has one handler for all of them.
window.gpgradMatrix = window.gpgradMatrix || {
  cell(svg, event) {
    const at = new DOMPoint(event.clientX, event.clientY)
      .matrixTransform(svg.getScreenCTM().inverse());
    const d = svg.dataset, cells = svg.cells || (svg.cells = JSON.parse(d.cells));
    const column = Math.floor((at.x - d.left) / d.side), row = Math.floor((at.y - d.top) / d.side);
    const inside = row >= 0 && column >= 0 && row < +d.rows && column < +d.columns;
    const text = cells[row + ',' + column] || (+d.mirrored && cells[column + ',' + row]);
    return {row, column, text: inside ? text : undefined};
  },
  move(svg, event) {
    const {row, column, text} = this.cell(svg, event), d = svg.dataset;
    const spot = svg.querySelector('[data-spot]');
    const said = svg.parentElement.querySelector('[data-said]');
    said.textContent = text || said.dataset.said;
    spot.setAttribute('visibility', text ? 'visible' : 'hidden');
    spot.setAttribute('x', +d.left + column * d.side);
    spot.setAttribute('y', +d.top + row * d.side);
    svg.style.cursor = text ? 'pointer' : 'default';
  },
  leave(svg) {
    const said = svg.parentElement.querySelector('[data-said]');
    said.textContent = said.dataset.said;
    svg.querySelector('[data-spot]').setAttribute('visibility', 'hidden');
  },
  click(svg, event) {
    const {row, column, text} = this.cell(svg, event);
    if (text) gpgrad.say('matrix', {name: svg.dataset.name, row, column});
  },
};
