// Keeps the address of a page, and says what it asks for. The canvas is to be known first: it decides
// how submaps stand, and so what a camera sees. The address is written over while the page stays on
// one entry of the browser's history; a link that a person puts into the address is another entry,
// and back and forward go between them.
(function run() {
  if (!window.gpgrad) { setTimeout(run, 50); return; }  // the bridge may come later
  const show = () => {
    for (const box of document.querySelectorAll('[data-testid=link]'))
      box.value = window.gpgradLink.link();
  };
  // After the server was gone: what was shown is asked for again.
  if (window.gpgradLink) { show(); window.gpgradLink.arrive(window.gpgradLink.text, true); return; }
  const own = window.gpgradLink = {
    text: '',
    link() { return own.text ? location.origin + location.pathname + '#' + own.text : ''; },
    copy(done) {
      const link = own.link();
      if (!link) { done(false); return; }
      const by_box = () => {
        const box = document.createElement('textarea');
        box.value = link; document.body.appendChild(box); box.select();
        const copied = document.execCommand('copy');
        box.remove(); done(copied);
      };
      if (!navigator.clipboard) by_box();
      else navigator.clipboard.writeText(link).then(() => done(true), by_box);
    },
    copyBy(button) {
      own.copy(done => {
        button.textContent = done ? 'Copied' : 'Select the link and copy it';
      });
    },
  };
  const asked = () => location.hash.slice(1);
  gpgrad.acts.address = text => {
    own.text = text;
    history.replaceState(history.state, '', location.pathname + location.search +
      (text ? '#' + text : ''));
    show();
  };
  window.addEventListener('hashchange', () => {
    if (!asked()) gpgrad.acts.address(own.text);
    else if (asked() !== own.text) {
      own.text = asked();  // which is asked for again, should the server be gone now
      show();
      gpgrad.say('asked', {text: own.text.slice(0, MOST_LETTERS)}, true);
    }
  });
  gpgrad.acts.where = data => gpgrad.say('here', {...data, link: own.link()});
  gpgrad.acts.copy = () => own.copy(copied => gpgrad.say('link copied', {copied}));
  own.arrive = (text, again) => {
    if (window.gpgradCanvas && window.gpgradCanvas.last)
      gpgrad.say('arrived', {text: text.slice(0, MOST_LETTERS), again});
    else setTimeout(own.arrive, 100, text, again);
  };
  own.arrive(asked(), false);
})()
