// Folders are as they were left, also after a reload: viser forgets it. They are buttons for the
// keyboard and for screen readers too. Escape folds those that a page begins without. On a phone that
// lies on its side, and where both panels would take most of a window that is nearly square, the left
// panel begins put away.
(() => {
  if (window.gpgradFolders) return;
  window.gpgradFolders = true;
  const low = matchMedia('(min-width: 641px) and (max-height: 480px), ' +
    '(min-width: 641px) and (max-width: 1100px) and (max-aspect-ratio: 3/2)');
  const PUT_AWAY = `${VISER_LEFT_DOCK} ${VISER_DOCK_COLLAPSE}[aria-expanded=true]`;
  let wanted = false;  // by whoever taps on it
  const KEY = 'gpgrad-folders', seen = new WeakSet(), drawers = new WeakSet();
  const read = () => { try { return JSON.parse(localStorage.getItem(KEY)) ?? {}; } catch { return {}; } };
  const is_folded = head => head.nextElementSibling?.getAttribute('aria-hidden') === 'true';
  const keep = head => {
    const kept = {...read(), [head.textContent]: is_folded(head)};
    try { localStorage.setItem(KEY, JSON.stringify(kept)); } catch { /* a private window */ }
  };
  document.addEventListener('click', event => {
    const head = event.isTrusted && event.target.closest?.(VISER_FOLDER_HEAD);
    const tabs = event.isTrusted && event.target.closest?.(VISER_FOLDED_TABS)?.parentElement;
    if (head) keep(head);
    if (!head && !tabs) return;
    // What unfolds at the foot of the window, or of a phone's panel, is shown once it is whole.
    const part = tabs || head;
    const show = height => setTimeout(() => {
      const now = part.parentElement.offsetHeight;
      if (now !== height) { show(now); return; }
      const beyond = head && innerHeight - head.getBoundingClientRect().bottom < 120;
      if (tabs || (beyond && !is_folded(head))) part.scrollIntoView({behavior: 'smooth'});
    }, 150);
    show(part.parentElement.offsetHeight - 1);
  }, true);
  document.addEventListener('pointerup', event => {
    const left = event.target.closest?.(VISER_LEFT_DOCK);
    if (left) wanted = true;
    // A tab of a panel that was put away brings the panel.
    if (left && event.target.closest(VISER_DOCK_TAB)) {
      setTimeout(() => left.querySelector(VISER_FOLDED_COLUMN)?.click());
    }
  }, true);
  window.addEventListener('keydown', event => {
    if (!['Enter', ' '].includes(event.key) || !event.target.matches?.(VISER_FOLDER_HEAD)) return;
    event.preventDefault(); event.stopImmediatePropagation();  // Space has a meaning of its own
    if (event.repeat) return;
    keep(event.target);
    event.target.click();
  }, true);
  document.addEventListener('keydown', event => {
    // In a box, Escape takes back what is typed; a list or a dialog that is open goes first.
    if (event.key !== 'Escape' || event.target.closest?.('input,textarea')) return;
    if (document.querySelector('[role=dialog]')) return;
    for (const head of document.querySelectorAll(VISER_FOLDER_HEAD)) {
      if (!drawers.has(head) || is_folded(head)) continue;
      keep(head);
      head.click();
    }
  });
  setInterval(() => {
    if (low.matches && !wanted) document.querySelector(PUT_AWAY)?.click();
    let kept = null;
    for (const head of document.querySelectorAll(VISER_FOLDER_HEAD)) {
      if (!head.textContent) continue;
      head.setAttribute('aria-expanded', !is_folded(head));
      // One that unfolds within a folded one would have no height: it waits for that one.
      if (seen.has(head) || head.closest('[aria-hidden=true]')) continue;
      seen.add(head);
      head.setAttribute('role', 'button');
      head.tabIndex = 0;
      if (is_folded(head)) drawers.add(head);
      const open = (kept ??= read())[head.textContent];
      if (open !== undefined && open === is_folded(head)) head.click();
    }
  }, 300);
})()
