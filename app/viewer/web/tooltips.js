// A tooltip stands on that side of the panel on which there is more room, over the picture.
(() => {
  if (window.gpgradTips) return;
  window.gpgradTips = true;
  document.addEventListener('pointerover', event => {
    const panel = event.target.closest && event.target.closest(VISER_DOCK);
    if (!panel) return;
    const box = panel.getBoundingClientRect(), style = document.documentElement.style;
    const isLeft = box.left + box.right < window.innerWidth;
    const left = isLeft ? `${box.right + 8}px` : 'auto';
    const right = isLeft ? 'auto' : `${window.innerWidth - box.left + 8}px`;
    style.setProperty('--gpgrad-tip-left', left);
    style.setProperty('--gpgrad-tip-right', right);
  }, {passive: true});
})()
