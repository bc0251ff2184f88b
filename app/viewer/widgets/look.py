"""The looks of viser's own widgets: contrast, sizes, one solid button, names, tooltips aside.

viser has no setting for any of these, but its pages take a style sheet in HTML. What is written
here depends on how viser builds its pages, as the bridge does, and a browser test watches it.
"""

from typing import Any

import viser

from app.viewer.host import Host
from app.viewer.widgets.bridge import run_when_shown

SOLID, SOLID_HOVER = "#1971c2", "#155fa3"
"""White words on them are readable, which they are not on viser's own blue."""

STYLE = """
:root, :root[data-mantine-color-scheme] {
  --mantine-color-dimmed: light-dark(#50575e, #bfc4c9) !important;
}
:where(button.mantine-Button-root:not([data-variant=outline], [data-disabled], [style*="-red-"])) {
  --button-bg: transparent !important;
  --button-hover: light-dark(#e6f0fa, #26333f) !important;
  --button-color: light-dark(#1659a0, #8cc3f7) !important;
  --button-bd: 1px solid light-dark(#6f9fce, #5f86ad) !important;
}
:where(button.mantine-Button-root[data-variant=outline]) {
  --button-color: light-dark(#1659a0, #8cc3f7) !important;
}
button.mantine-Button-root { min-height: 32px; }
.mantine-Slider-root + .mantine-NumberInput-root { width: 3.9rem !important; }
/* The number stands in the box beside the slider, and need not cover the slider above. */
.mantine-Slider-label { display: none; }
.mantine-Slider-thumb { width: .7rem !important; height: 1.1rem !important; }
[data-dock-strip] { flex-wrap: nowrap !important; }
[data-dock-strip] > [data-dock-tab] {
  padding: 0 3.9px !important; flex: 0 0 auto !important; letter-spacing: -.2px;
}
[data-dock-strip] > [data-dock-tab], [data-dock-strip] > [data-dock-tab] * {
  font-size: 12.5px !important; max-width: none !important;
}
[data-dock-tab][aria-selected=true] { color: light-dark(#1659a0, #8cc3f7) !important; }
.tabler-icon-cloud-check { visibility: hidden; }
/* A dock that was empty for a moment, as when the mode changes, comes back in viser's own width. */
@media (min-width: 641px) {
  [data-dock-region=left]:has([data-dock-group]),
  [data-dock-region=left] > div > div:has([data-dock-group]) { min-width: 324px !important; }
}
@media (max-width: 640px) {
  .mantine-Paper-root:has([data-testid=verdict]) { left: 0 !important; width: 100% !important; }
  .mantine-Paper-root:has([data-testid=verdict]) .mantine-ScrollArea-content > div {
    width: 100% !important;
  }
  [data-testid=caption] div { font-size: 12px !important; line-height: 1.2; white-space: nowrap; }
}
@media (min-width: 700px) {
  .mantine-Tooltip-tooltip {
    left: var(--gpgrad-tip-left, auto) !important;
    right: var(--gpgrad-tip-right, auto) !important;
  }
  .mantine-Tooltip-arrow { display: none; }
}
"""
# A tooltip stands on that side of the panel on which there is more room, over the picture.
BESIDE = """
(() => {
  if (window.gpgradTips) return;
  window.gpgradTips = true;
  document.addEventListener('pointerover', event => {
    const panel = event.target.closest && event.target.closest('[data-dock-group]');
    if (!panel) return;
    const box = panel.getBoundingClientRect(), style = document.documentElement.style;
    const isLeft = box.left + box.right < window.innerWidth;
    const left = isLeft ? `${box.right + 8}px` : 'auto';
    const right = isLeft ? 'auto' : `${window.innerWidth - box.left + 8}px`;
    style.setProperty('--gpgrad-tip-left', left);
    style.setProperty('--gpgrad-tip-right', right);
  }, {passive: true});
})()
"""


# Screen readers hear of a slider, and of a button with a picture, only what it is called. An arrow
# key that moves a slider must not fly the camera as well, which listens to the whole page.
REACH = """
(() => {
  if (window.gpgradReach) return;
  window.gpgradReach = true;
  setInterval(() => {
    for (const thumb of document.querySelectorAll('.mantine-Slider-thumb')) {
      if (thumb.getAttribute('aria-label')) continue;
      const root = thumb.closest('.mantine-Slider-root');
      const label = root && document.querySelector(`label[for="${root.id}"]`);
      if (!label) continue;
      thumb.setAttribute('aria-label', label.textContent);
      const typed = root.parentElement.querySelector('input:not([type=hidden])');
      if (typed) typed.setAttribute('aria-label', label.textContent + ', typed');
    }
    for (const pressed of document.querySelectorAll('.mantine-ActionIcon-root')) {
      if (pressed.getAttribute('aria-label') || pressed.textContent.trim()) continue;
      const icon = pressed.querySelector('svg')?.getAttribute('class') ?? '';
      const kind = icon.match(/tabler-icon-([a-z-]+)/)?.[1] ?? 'more';
      const names = {'list-search': 'Commands', 'adjustments': 'Settings of the page'};
      pressed.setAttribute('aria-label', names[kind] ?? kind.replaceAll('-', ' '));
    }
  }, 700);
  const keys = ['ArrowLeft', 'ArrowRight', 'ArrowUp', 'ArrowDown'];
  document.body.addEventListener('keydown', event => {
    const over = event.target.closest && event.target.closest('[role=slider],input,select');
    if (over && keys.includes(event.key)) event.stopPropagation();
  });
})()
"""
# viser dims its panels while it has no connection, and connects again by itself. What it says of
# that is a red dot. A page in the background waits until it is looked at.
CONNECTION = """
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
    const dimmed = 'div[style*="opacity: 0.5"][style*="pointer-events: none"]';
    const gone = document.querySelector(dimmed);
    if (gone) {
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
"""


class Look:
    """The style sheet of a session's pages, and what their widgets lack."""

    def __init__(self, host: Host) -> None:
        """Put it into the current container, unseen.

        Args:
            host: Whose pages it is for.
        """
        host.gui.add_html(
            f"<style>{STYLE}</style>"
            + "".join(run_when_shown(script) for script in (BESIDE, REACH, CONNECTION))
        )


def uuid_of(
    handle: viser.GuiInputHandle[Any] | viser.GuiButtonHandle | viser.GuiButtonGroupHandle,
) -> str:
    """Give the name by which a page knows a widget."""
    return handle._impl.uuid  # pyright: ignore[reportPrivateUsage]


def make_solid(host: Host, button: viser.GuiButtonHandle) -> None:
    """Let a button stand out: it does what its panel is for. All others are light."""
    host.gui.add_html(
        f'<style>button[id="{uuid_of(button)}"]:not([data-disabled]){{'
        f"--button-bg:{SOLID}!important;--button-hover:{SOLID_HOVER}!important;"
        f"--button-color:#fff!important;--button-bd:none!important}}</style>"
    )


def segment_style(buttons: viser.GuiButtonGroupHandle, chosen: int) -> str:
    """Write the style that turns a group of buttons into one control, without its label.

    Args:
        buttons: The group.
        chosen: Which of them is filled, from 0.
    """
    label = f'div:has(> p > label[for="{uuid_of(buttons)}"])'
    group = f"{label} + div div:has(> button)"
    return (
        f"<style>{label}{{display:none}}{group}{{gap:0!important}}"
        f"{group} > button{{min-height:34px;border-radius:0;border-left-width:0;font-size:.9em}}"
        f"{group} > button:first-of-type{{border-radius:6px 0 0 6px;border-left-width:1px}}"
        f"{group} > button:last-of-type{{border-radius:0 6px 6px 0}}"
        f"{group} > button:nth-of-type({chosen + 1}){{background:{SOLID}!important;"
        f"color:#fff!important}}</style>"
    )
