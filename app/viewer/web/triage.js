// Letters fly the camera too. While the list of the triage is to be seen, these decide instead.
if (!window.gpgradTriage) {
  window.gpgradTriage = true;
  window.addEventListener('keydown', event => {
    const list = document.querySelector('[data-testid=triage]');
    const key = event.key.toLowerCase();
    if (!'axg'.includes(key) || key.length !== 1 || !list || !list.getClientRects().length) return;
    if (event.ctrlKey || event.metaKey || event.altKey || event.shiftKey) return;
    const at = event.target;
    if (at && at.closest && at.closest('input,textarea,select,[contenteditable=true]')) return;
    event.preventDefault();
    event.stopImmediatePropagation();
    if (!event.repeat) gpgrad.say('triage-key', {key});
  }, true);
}
