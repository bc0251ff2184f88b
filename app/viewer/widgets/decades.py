"""Sliders on which equal ways are equal factors: one millimetre matters at 5 mm, not at 50 cm.

viser's sliders are linear. A script of ours puts their thumbs and marks where they belong on such
a scale, and turns what a hand or a key does there into a number in the box beside the slider, as if
it had been typed. This depends on how viser builds its pages, as the bridge does, and a browser
test watches it.
"""

from collections.abc import Sequence
from typing import Any

import viser

from app.viewer.host import Host
from app.viewer.web import fill_page_file
from app.viewer.widgets.bridge import run_when_shown
from app.viewer.widgets.look import uuid_of
from gpgrad_core.params.bounds import DIGITS


def spread_over_decades(host: Host, sliders: Sequence[viser.GuiSliderHandle[Any]]) -> None:
    """Let equal ways on some sliders be equal factors; their lower ends must be above zero.

    Args:
        host: Whose pages they are on; the script joins the current container, unseen.
        sliders: As viser made them.
    """
    whole = {uuid_of(slider): isinstance(slider.value, int) for slider in sliders}
    script = run_when_shown(fill_page_file("decades.js", SLIDERS=whole, DIGITS=DIGITS))
    host.gui.add_html(f"<style>{fill_page_file('decades.css')}</style>{script}")
