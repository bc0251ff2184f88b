// Puts a chip onto the number box of each slider that has one; the newest chips are kept, because
// viser builds a slider anew when its folder opens.
(chips => {
  window.gpgradChips = chips;
  const place = () => {
    for (const [id, {word, hint, back}] of Object.entries(window.gpgradChips)) {
      const field = document.getElementById(id)?.nextElementSibling;
      if (!field?.matches(VISER_NUMBER_FIELD)) continue;
      const kind = back ? 'BUTTON' : 'SPAN';
      let chip = field.querySelector('[data-chip]');
      if (chip && chip.tagName !== kind) { chip.remove(); chip = null; }
      if (!chip) {
        chip = field.appendChild(document.createElement(kind));
        if (back) {
          chip.type = 'button';
          chip.addEventListener('click', () => gpgrad.say('way-back', {widget: id}));
        }
      }
      if (chip.dataset.chip === word && chip.title === hint) continue;
      chip.dataset.chip = chip.textContent = word;
      chip.title = hint;
      if (back) chip.setAttribute('aria-label', hint);
    }
  };
  place();
  if (window.gpgradChipsWatched) return;
  window.gpgradChipsWatched = true;
  let waits = false;
  new MutationObserver(() => {
    if (waits) return;
    waits = true;
    setTimeout(() => { waits = false; place(); }, 100);
  }).observe(document.body, {subtree: true, childList: true});
})(CHIPS)
