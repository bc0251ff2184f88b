// The first act of a person that follows is told once: a key, a press anywhere, or the wheel. What
// viser itself puts up, such as its warning of a slow graphics card, may be put away.
(number => {
  const kinds = ['pointerdown', 'keydown', 'wheel'];
  if (window.gpgradWatched === undefined) {
    for (const kind of kinds) document.addEventListener(kind, event => {
      const number = window.gpgradWatched;
      const over = event.target.closest && event.target.closest(VISER_NOTIFICATION);
      if (number === null || over) return;
      window.gpgradWatched = null;
      gpgrad.say('touched', {number});
    }, {capture: true, passive: true});
  }
  window.gpgradWatched = number;
})(NUMBER)
