// Screen readers hear of a slider, a button with a picture, and a bar only what it is called. An arrow
// key that moves a slider must not fly the camera as well, which listens to the whole page.
(() => {
  if (window.gpgradReach) return;
  window.gpgradReach = true;
  const name = () => {
    for (const bar of document.querySelectorAll('[role=progressbar]:not([aria-label])')) {
      bar.setAttribute('aria-label', 'Progress');
    }
    for (const thumb of document.querySelectorAll(VISER_SLIDER_THUMB)) {
      if (thumb.getAttribute('aria-label')) continue;
      const root = thumb.closest(VISER_SLIDER);
      const label = root && document.querySelector(`label[for="${root.id}"]`);
      if (!label) continue;
      thumb.setAttribute('aria-label', label.textContent);
      const typed = root.parentElement.querySelector(VISER_TYPED_BOX);
      if (typed) typed.setAttribute('aria-label', label.textContent + ', typed');
    }
    // What can be scrolled is reached by keys, too.
    for (const list of document.querySelectorAll(`[role=dialog] ${VISER_SCROLLED} > :first-child`)) {
      list.tabIndex = 0;
    }
    // Of two boxes in a row, viser names the first only.
    for (const box of document.querySelectorAll(`${VISER_NUMBER_FIELD} input:not([aria-label])`)) {
      const label = !box.labels?.length && [...document.querySelectorAll(`${VISER_ROW} label`)].find(
        one => one.closest(VISER_ROW).contains(box));
      if (label) box.setAttribute('aria-label', label.textContent);
    }
    for (const pressed of document.querySelectorAll(VISER_ICON_BUTTON)) {
      if (pressed.getAttribute('aria-label') || pressed.textContent.trim()) continue;
      const icon = pressed.querySelector('svg')?.getAttribute('class') ?? '';
      const kind = icon.split(VISER_ICON_CLASS)[1]?.split(' ')[0] ?? 'more';
      const names = {'list-search': 'Commands', 'adjustments': 'Theme: dark, light, or as the system is'};
      pressed.setAttribute('aria-label', names[kind] ?? kind.replaceAll('-', ' '));
    }
  };
  name();
  new MutationObserver(name).observe(document.body, {childList: true, subtree: true});
  const keys = ['ArrowLeft', 'ArrowRight', 'ArrowUp', 'ArrowDown'];
  document.body.addEventListener('keydown', event => {
    const over = event.target.closest && event.target.closest('[role=slider],input,select');
    if (over && keys.includes(event.key)) event.stopPropagation();
  });
})()
