// A range of the values in the histogram: a drag chooses it, a click one bar, and a click on what
// is chosen nothing again. The server hears both ends as shares of the width.
if (!window.gpgradCells) {
  const state = window.gpgradCells = {svg: null, start: 0, end: 0};
  const shareOf = event => {
    const {left, width} = state.svg.getBoundingClientRect();
    return Math.min(Math.max((event.clientX - left) / width, 0), 1);
  };
  document.addEventListener('pointerdown', event => {
    state.svg = event.target.closest?.('[data-testid=histogram]');
    if (!state.svg) return;
    event.preventDefault();
    state.start = state.end = shareOf(event);
  });
  document.addEventListener('pointermove', event => {
    if (!state.svg) return;
    state.end = shareOf(event);
    const band = state.svg.querySelector('[data-band]');
    const width = state.svg.viewBox.baseVal.width;
    band.setAttribute('x', width * Math.min(state.start, state.end));
    band.setAttribute('width', width * Math.abs(state.end - state.start));
  });
  document.addEventListener('pointerup', () => {
    if (!state.svg) return;
    const [low, high] = [state.start, state.end].sort((a, b) => a - b);
    gpgrad.say('cells', {low, high});
    state.svg = null;
  });
}
