"""The associations: a flat picture of them, and the figures of the one that is pointed at."""

import json
from collections.abc import Callable
from dataclasses import dataclass
from html import escape

import numpy as np
from jaxtyping import UInt8

from app.viewer.host import Host
from app.viewer.widgets.actions import on_choice, on_option
from app.viewer.widgets.bridge import run_when_shown
from app.viewer.widgets.html import BAD, FAINT, paragraph, table
from app.viewer.widgets.numbers import Numbers
from gpgrad_core.arrays import NDArray
from gpgrad_core.params.bounds import Bounds

PREVIOUS, NEXT, NONE = "previous", "next", "none"
JPEG_QUALITY = 85
NO_PICTURE = np.zeros((2, 2, 3), dtype=np.uint8)
"""Stands in, unseen, until the first is drawn."""
SEEN = "flat-picture-seen"
"""What a page says when the flat picture comes into view, or goes."""
# A pixel above the picture is watched instead of it: viser puts a new one there for each picture.
WATCH = '<div data-testid="flat-picture" style="height:1px"></div>' + run_when_shown(
    f"""
const mark = this.parentElement.querySelector('[data-testid=flat-picture]');
(function run() {{
  if (!window.gpgrad) {{ setTimeout(run, 50); return; }}  // the bridge may come later
  new IntersectionObserver(all => gpgrad.say({json.dumps(SEEN)},
    {{seen: all[all.length - 1].isIntersecting}}, true)).observe(mark);
}})()
"""
)
MATCHES = Bounds(0, 1_000_000, 1)
"""Numbers of associations; there are fewer, and one that there is not is none."""
NO_MATCH = "Choose an association by its number, or with the keys N and P. Both pictures show it."


@dataclass(frozen=True)
class MatchFigures:
    """What is known of one association.

    Attributes:
        inlier: Whether it agrees with the registration.
        distance: Between the descriptors.
        rank: Place among all associations by that distance, 1 being the closest.
        count: Of all associations.
        residual: How far it misses under the motion found [m]; None without a motion.
        allowed: The inlier radius [m].
        query_xy: In the query's frame [m].
        database_xy: In the database's frame [m].
    """

    inlier: bool
    distance: float
    rank: int
    count: int
    residual: float | None
    allowed: float
    query_xy: tuple[float, float]
    database_xy: tuple[float, float]


@dataclass(frozen=True)
class Key:
    """One line of the picture's legend: a colour, and what has it."""

    color: str
    text: str


class MatchesPanel:
    """Number box, steps, figures and picture; callbacks must be quick."""

    def __init__(
        self,
        host: Host,
        *,
        on_match: Callable[[int], None],
        on_step: Callable[[int], None],
        numbers: Numbers | None = None,
    ) -> None:
        """Make the widgets in the current container.

        Args:
            host: Whose GUI they join.
            on_match: Given the number asked for; 0 for none.
            on_step: Given 1 for the next, -1 for the previous.
            numbers: Takes what is typed into the box.
        """
        gui = host.gui
        self._number = gui.add_number(
            "Association",
            0,
            min=0,
            step=1,
            hint="Number of an association, from 1; 0 chooses none.",
        )
        self._steps = gui.add_button_group(
            "Step association",
            (PREVIOUS, NEXT, NONE),
            hint="Steps through the associations of the kinds that have lines (keys P and N).",
        )
        self._figures = gui.add_html(paragraph(NO_MATCH, FAINT))
        self._title = gui.add_html("")
        gui.add_html(WATCH)
        self._image = gui.add_image(
            NO_PICTURE, format="jpeg", jpeg_quality=JPEG_QUALITY, visible=False
        )
        self._key = gui.add_html("")

        on_choice(self._number, lambda number: on_match(int(number)))
        if numbers is not None:
            numbers.add(self._number, MATCHES, lambda number: on_match(int(number)))
        on_option(
            self._steps,
            lambda label: on_match(0) if label == NONE else on_step(1 if label == NEXT else -1),
        )

    def show_match(self, number: int, figures: MatchFigures | None) -> None:
        """Show the figures of an association, or with None that none is pointed at."""
        self._number.value = number
        self._figures.content = (
            paragraph(NO_MATCH, FAINT) if figures is None else match_html(number, figures)
        )

    def show_picture(
        self, image: UInt8[NDArray[np.uint8], "rows columns 3"], title: str, key: tuple[Key, ...]
    ) -> None:
        """Show the flat picture, its title and its legend."""
        self._image.image = image
        self._image.visible = True
        self._title.content = paragraph(title, FAINT)
        self._key.content = key_html(key)

    def show_nothing(self, why: str) -> None:
        """Show neither an association nor a picture, because there is no pair."""
        self.show_match(0, None)
        self._image.visible = False
        self._title.content = paragraph(why, FAINT)
        self._key.content = ""

    def failed(self, message: str) -> None:
        """Say why there is no new picture; the last one stays."""
        self._title.content = paragraph(message, f"color:{BAD}")


def match_html(number: int, figures: MatchFigures) -> str:
    """Write the figures of one association."""
    kind = "inlier" if figures.inlier else "outlier"
    rows = [("descriptor distance", f"{figures.distance:.3f} (rank {figures.rank})")]
    if figures.residual is None:
        rows.append(("residual", "unknown: no motion was found"))
    else:
        rows.append(
            ("residual", f"{figures.residual:.3f} m (at most {figures.allowed:g} m for an inlier)")
        )
    rows += [
        ("in the query", _position(figures.query_xy)),
        ("in the database", _position(figures.database_xy)),
    ]
    return (
        f'<div data-testid="match" style="padding:.1em .75em .3em">'
        f'<div style="font-size:.85em;font-weight:600">Association {number} of {figures.count:,}: '
        f"{kind}</div>{table(tuple(rows))}</div>"
    )


def key_html(key: tuple[Key, ...]) -> str:
    """Write a legend: a patch of colour and words, line by line."""
    lines = "".join(
        f'<div style="white-space:nowrap"><span style="display:inline-block;width:.8em;'
        f"height:.8em;border-radius:.15em;margin-right:.45em;vertical-align:-.05em;"
        f'background:{escape(line.color)}"></span>{escape(line.text)}</div>'
        for line in key
    )
    return (
        f'<div data-testid="pane-key" style="padding:.1em .75em .4em;font-size:.8em;'
        f'line-height:1.5">{lines}</div>'
    )


def _position(xy: tuple[float, float]) -> str:
    return f"x {xy[0]:+z.2f} m, y {xy[1]:+z.2f} m"
