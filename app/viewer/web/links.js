// Keeps the address of a page, and says what it asks for. The canvas is to be known first: it decides
// how submaps stand, and so what a camera sees. Another pair, dataset or mode is another entry of the
// browser's history if the person at this page has just acted; all else is written over the entry.
// A link that a person puts into the address is an entry too, and back and forward go between them.
(function run() {
  if (!window.gpgrad) { setTimeout(run, 50); return; }  // the bridge may come later
  const show = () => {
    for (const box of document.querySelectorAll('[data-testid=link]'))
      box.value = window.gpgradLink.link();
  };
  // After the server was gone: what was shown is asked for again. This may also be put into the page
  // once more while it has not arrived yet.
  if (window.gpgradLink) {
    show();
    if (window.gpgradLink.arrived) window.gpgradLink.arrive(true);
    return;
  }
  const asked = () => location.hash.slice(1);
  const first = asked();
  let acted = 0;  // when the person did something here
  for (const name of ['pointerdown', 'keydown']) {
    window.addEventListener(name, event => { if (event.isTrusted) acted = Date.now(); }, true);
  }
  const own = window.gpgradLink = {
    text: null,  // until the server says what is shown
    link() { return own.text ? location.origin + location.pathname + '#' + own.text : ''; },
    copy(done) {
      const link = own.link();
      if (link) gpgrad.copy(link, done); else done(false);
    },
    copyBy(button) {
      own.copy(done => {
        button.textContent = done ? 'Copied' : 'Select the link and copy it';
      });
    },
  };
  gpgrad.acts.address = ({text, place}) => {
    Object.assign(own, {text, place});
    const before = history.state?.place;
    const isNew = text && before && before !== place && Date.now() - acted < ACTED_MS;
    // By its own name: keep_hash.js has the other.
    History.prototype[isNew ? 'pushState' : 'replaceState'].call(history,
      {...history.state, place}, '', location.pathname + location.search + (text ? '#' + text : ''));
    show();
  };
  // The first of these comes at once. A busy page hears the second later, perhaps after an address
  // of before from the server, which takes the place of what was asked for.
  for (const name of ['popstate', 'hashchange']) window.addEventListener(name, () => {
    acted = 0;
    if (!asked()) gpgrad.acts.address(own);
    else if (asked() !== own.text) {
      own.text = asked();  // which is asked for again, should the server be gone now
      show();
      const mode = history.state?.place?.split(' ')[0] ?? '';
      gpgrad.say('asked', {text: own.text.slice(0, MOST_LETTERS), mode}, true);
    }
  });
  gpgrad.acts.where = data => gpgrad.say('here', {...data, link: own.link()});
  gpgrad.acts.copy = () => own.copy(copied => gpgrad.say('link copied', {copied}));
  own.arrive = again => {
    own.arrived = Boolean(window.gpgradCanvas && window.gpgradCanvas.last);
    if (own.arrived) gpgrad.say('arrived', {text: (own.text ?? first).slice(0, MOST_LETTERS), again});
    else setTimeout(own.arrive, 100, again);
  };
  own.arrive(false);
})()
