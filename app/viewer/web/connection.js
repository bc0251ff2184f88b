// viser dims its panels while it has no connection, and connects again by itself. What it says of
// that is a red dot. A page in the background waits until it is looked at.
(() => {
  if (window.gpgradConnection) return;
  const own = window.gpgradConnection = {missed: 0, banner: null};
  const say = (text, back) => {
    if (!own.banner) {
      own.banner = document.createElement('div');
      own.banner.dataset.testid = 'connection';
      own.banner.setAttribute('role', 'alert');
      document.body.appendChild(own.banner);
    }
    own.banner.style.cssText = 'position:fixed;top:0;left:0;right:0;z-index:1000;color:#fff;' +
      'text-align:center;padding:.6em 1em;font:600 15px/1.4 var(--mantine-font-family);' +
      'background:' + (back ? '#1a7f37' : '#a32a25');
    own.banner.textContent = text;
  };
  setInterval(() => {
    if (document.querySelector(VISER_DISCONNECTED)) {
      own.missed += 1;
      if (own.missed === 2) say("The viewer's server does not answer. What you see is its last " +
        'picture. This page connects again by itself once the server is back.', false);
    } else if (own.missed) {
      const told = own.missed >= 2;
      own.missed = 0;
      if (!told) return;
      say('Connected again.', true);
      setTimeout(() => {
        if (!own.missed && own.banner) { own.banner.remove(); own.banner = null; }
      }, 6000);
    }
  }, 700);
})()
