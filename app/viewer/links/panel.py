"""The link in a box with a button that copies it; and the script that keeps the address."""

from html import escape

import viser

from app.viewer.host import Host
from app.viewer.links.address import LONGEST
from app.viewer.widgets.bridge import run_when_shown
from app.viewer.widgets.html import paragraph

# The canvas is to be known first: it decides how submaps stand, and so what a camera sees. The
# address is written over while the page stays on one entry of the browser's history; a link that a
# person puts into the address is another entry, and back and forward go between them.
SCRIPT = """
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
      gpgrad.say('asked', {text: own.text.slice(0, LONGEST + 1)}, true);
    }
  });
  gpgrad.acts.where = data => gpgrad.say('here', {...data, link: own.link()});
  gpgrad.acts.copy = () => own.copy(copied => gpgrad.say('link copied', {copied}));
  own.arrive = (text, again) => {
    if (window.gpgradCanvas && window.gpgradCanvas.last)
      gpgrad.say('arrived', {text: text.slice(0, LONGEST + 1), again});
    else setTimeout(own.arrive, 100, text, again);
  };
  own.arrive(asked(), false);
})()
""".replace("LONGEST + 1", str(LONGEST + 1))
COPY = (
    "const one=this;gpgradLink.copy(done=>{one.textContent=done?'Copied':"
    "'Select the link and copy it';})"
)
NO_LINK = (
    "This dataset has no link, because it was uploaded or has no path on the server. Save the "
    "session instead."
)


class LinkPanel:
    """The link of the page that shows it: each page has a camera, so each has a link of its own."""

    def __init__(self, host: Host) -> None:
        """Make the widgets in the current container.

        Args:
            host: Whose GUI they join.
        """
        self._body = host.gui.add_html(link_html(has_link=True))

    def show(self, *, has_link: bool) -> None:
        """Show the link, or say that there is none."""
        content = link_html(has_link=has_link)
        if self._body.content != content:
            self._body.content = content


def script_html() -> str:
    """Write the script, for a place that is always mounted."""
    return run_when_shown(SCRIPT)


def link_html(*, has_link: bool) -> str:
    """Write the box with the link, and the button that copies it."""
    if not has_link:
        return paragraph(NO_LINK, "opacity:.8")
    intro = paragraph(
        "The address of this page follows what is shown: dataset, pair, parameters, layers and "
        "camera. Whoever opens it on this viewer sees the same."
    )
    fill = run_when_shown(
        "window.gpgradLink&&(this.parentNode.querySelector('input').value=gpgradLink.link())"
    )
    return (
        f'{intro}<div style="padding:.2em .75em .4em">'
        f'<input data-testid="link" readonly aria-label="Link" onfocus="this.select()" '
        f'style="width:100%;box-sizing:border-box;font:.75em monospace;color:inherit;height:32px;'
        f"background:transparent;border:1px solid currentColor;border-radius:.3em;"
        f'opacity:.9;margin-bottom:.3em">'
        f"{fill}"
        f'<button type="button" data-testid="copy-link" onclick="{escape(COPY)}" '
        f'style="width:100%;min-height:32px;background:#1971c2;color:#fff;border:0;'
        f'border-radius:.2em;cursor:pointer;font:inherit;font-size:.85em">Copy link</button></div>'
    )


def tell(page: viser.ClientHandle, title: str, body: str) -> None:
    """Say something about a link to the page that it concerns."""
    page.add_notification(title, body, auto_close_seconds=12.0, with_close_button=True)
