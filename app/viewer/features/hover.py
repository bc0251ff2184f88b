"""What is under the cursor: read-out, crosshair in both submaps, a keypoint and its partner."""

import threading
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from html import escape
from typing import Annotated, TypeAlias

import numpy as np
import viser
from jaxtyping import Float
from msgspec import Meta, Struct

from app.viewer.charts import png_uri
from app.viewer.features.desk import Desk, Feature
from app.viewer.features.pair import PairScene, Picture
from app.viewer.features.world import WorldTab
from app.viewer.scene.associations import (
    KINDS,
    describe_match,
    inlier_color,
    keypoint_kinds,
    shown_kinds,
)
from app.viewer.scene.cameras import line_of_sight, place_on_screen, view_of
from app.viewer.scene.colors import CHOSEN, colorize, css
from app.viewer.scene.probing import Ray, label_text, sample
from app.viewer.server.host import PerPage, pages
from app.viewer.session.jobs import Throttle
from app.viewer.session.news import SessionState
from app.viewer.session.state import ROLES, Probe
from app.viewer.widgets.legend import KIND_NAMES, mark_svg
from gpgrad_core.arrays import Array
from gpgrad_core.detection import PairResult

Light: TypeAlias = Callable[[viser.ClientHandle, tuple[str, ...]], None]
"""Lights up a submap or two of the map on a page, and their cell of the matrix."""
SignedPixels: TypeAlias = Annotated[float, Meta(ge=-100_000.0, le=100_000.0)]
REACH = 9.0
"""A keypoint, and what is pinned, is meant from so near [pixels]."""
PATCH = 56
"""Side of a patch of gradient [pixels]."""
PATCH_SCALES = 0.75
"""Half the side of a patch, over the diameter of what the descriptor covers."""
PAUSE = 0.02
"""Between two read-outs [s]."""


NOTHING: dict[str, object] = {"places": [], "card": ""}


class CursorMsg(Struct):
    """Where a page's cursor is: pixels from the upper left corner of its canvas."""

    x: SignedPixels
    y: SignedPixels


@dataclass(frozen=True)
class Keypoint:
    """A keypoint under the cursor."""

    index: int  # of the query (0) or the database (1), whose it is
    number: int  # its place among the keypoints of that map
    match: int | None  # its association, an inlier if there is one; None without a partner


class Hover(Feature):
    """Says what is under the cursor of a page, and where that is in the other submap."""

    def __init__(self, desk: Desk, pair: PairScene, world: WorldTab, light: Light) -> None:
        self._desk = desk
        self._pair = pair
        self._world, self._light = world, light
        self._lit = PerPage[tuple[str, ...]]()
        self._lock = threading.Lock()
        # The newest of each page: where its cursor is, and where it clicked.
        self._newest = PerPage[dict[str, CursorMsg]]()
        self._throttle: Throttle[viser.ClientHandle] = Throttle(desk.jobs, self._serve, PAUSE)
        for name in ("cursor", "pin"):
            desk.bridge.on_message(name, CursorMsg, partial(self._take, name))

    def _take(self, name: str, page: viser.ClientHandle, cursor: CursorMsg) -> None:
        with self._lock:
            self._newest.setdefault(page, {})[name] = cursor
        self._throttle.request(page)

    def on_state(self, before: SessionState, state: SessionState) -> None:
        if state.subject != before.subject:
            for page in pages(self._desk.host).values():
                self._clear(page)

    def _clear(self, page: viser.ClientHandle) -> None:
        if self._lit.pop(page, ()):
            self._light(page, ())
            self._desk.canvases.show(page, "marks", NOTHING)

    def _serve(self, page: viser.ClientHandle) -> None:
        with self._lock:
            newest = self._newest.pop(page, {})
        if page not in pages(self._desk.host).values() or not self._desk.canvases.knows(page):
            return
        is_map = self._desk.now.subject == "world"
        if "pin" in newest:
            if is_map:  # the camera may fly from there
                self._clear(page)
                return
            self._pin(page, newest["pin"])
        if (at := newest.get("cursor")) is not None:
            marks = self._look_at_map(page, at) if is_map else self._look(page, at)
            self._desk.canvases.show(page, "marks", {**marks, "at": at.x, "color": css(CHOSEN)})

    def _look_at_map(self, page: viser.ClientHandle, at: CursorMsg) -> dict[str, object]:
        ray, focal = self._ray(page, at), self._desk.canvases.of(page).focal_length(view_of(page))
        names, card = self._world.look(ray.origin, ray.direction, REACH / focal)
        if names != self._lit.get(page, ()):
            self._lit[page] = names
            if at.x >= 0.0:  # a cursor that has left the canvas was cleared by its page
                self._light(page, names)
        return {"places": [], "card": card}

    def _look(self, page: viser.ClientHandle, at: CursorMsg) -> dict[str, object]:
        """Find what is to be shown for a place of the canvas: places on it, and words."""
        picture, ray = self._pair.picture, self._ray(page, at)
        if picture is None or not self._pair.visible:
            return NOTHING
        keypoint = self._keypoint_at(page, picture, at)
        if keypoint is not None and picture.result is not None:
            spots = keypoint_spots(picture, picture.result, keypoint)
            card = keypoint_card(picture, picture.result, keypoint)
            return {"places": self._on_page(page, spots), "card": card, "joined": len(spots) > 1}
        probe = self._pair.pick(ray)
        if probe is None:
            return NOTHING
        return {
            "places": self._on_page(page, picture.spots(probe)),
            "card": reading_card(picture, probe),
        }

    def _pin(self, page: viser.ClientHandle, at: CursorMsg) -> None:
        """Pin what is under a click; unpin it if it is pinned already."""
        picture = self._pair.picture
        if picture is None or not self._pair.visible:
            return
        state = self._desk.state
        keypoint = self._keypoint_at(page, picture, at)
        if keypoint is not None and keypoint.match is not None:
            number = keypoint.match + 1
            self._desk.change(match=0 if number == state.match else number)
            return
        if state.probe is not None:
            kept = np.array(self._on_page(page, picture.spots(state.probe)[:1]))
            if len(kept) and np.hypot(*(kept[0] - (at.x, at.y))) < REACH:
                self._desk.change(probe=None)
                return
        probe = self._pair.pick(self._ray(page, at))
        if probe is not None:
            self._desk.change(probe=probe)

    def _ray(self, page: viser.ClientHandle, at: CursorMsg) -> Ray:
        return Ray(*line_of_sight(view_of(page), self._desk.canvases.of(page), at.x, at.y))

    def _on_page(
        self, page: viser.ClientHandle, spots: tuple[Float[Array, "3"], ...]
    ) -> list[list[float]]:
        if not spots:
            return []
        places = place_on_screen(view_of(page), self._desk.canvases.of(page), np.array(spots))
        return [np.round(place, 1).tolist() for place in places if np.isfinite(place).all()]

    def _keypoint_at(
        self, page: viser.ClientHandle, picture: Picture, at: CursorMsg
    ) -> Keypoint | None:
        """Find the keypoint nearest to a place of the canvas, if one is near; partners first."""
        result, kinds = picture.result, shown_kinds(picture.state.options)
        if result is None or not kinds:
            return None
        view, canvas = view_of(page), self._desk.canvases.of(page)
        best, nearest = REACH, None
        for index, features in enumerate(result.features):
            places = place_on_screen(
                view, canvas, picture.keypoint_spots(index, features.positions)
            )
            away = np.hypot(places[:, 0] - at.x, places[:, 1] - at.y)
            # The small marks have to be met, and do not hide those that say more.
            kind = keypoint_kinds(result, index)
            away += (kind == KINDS.index("unmatched")) * REACH / 2
            away[~np.isin(kind, [KINDS.index(name) for name in kinds])] = np.nan
            if len(away) and np.nanmin(np.append(away, np.inf)) < best:
                number = int(np.nanargmin(away))
                best, nearest = float(away[number]), (index, number)
        if nearest is None:
            return None
        return Keypoint(*nearest, _match_of(result, *nearest))


def _match_of(result: PairResult, index: int, number: int) -> int | None:
    """An association of a keypoint, an inlier if it has one."""
    matches = np.flatnonzero(result.matches.pairs[:, index] == number)
    if not len(matches):
        return None
    return int(matches[np.argmax(result.registration.inliers[matches])])


def _ends(result: PairResult, keypoint: Keypoint) -> list[tuple[int, int]]:
    """List the keypoint and its partner as (query or database, number), the query's first."""
    if keypoint.match is None:
        return [(keypoint.index, keypoint.number)]
    query, database = result.matches.pairs[keypoint.match].tolist()
    return [(0, query), (1, database)]


def keypoint_spots(
    picture: Picture, result: PairResult, keypoint: Keypoint
) -> tuple[Float[Array, "3"], ...]:
    """The positions of a keypoint and its partner in the scene [m], unless they are hidden."""
    features = result.features
    spots = [
        picture.keypoint_spots(index, features[index].positions[number : number + 1])[0]
        for index, number in _ends(result, keypoint)
    ]
    return tuple(spot for spot in spots if np.isfinite(spot).all())


def keypoint_card(picture: Picture, result: PairResult, keypoint: Keypoint) -> str:
    """Write what became of a keypoint, with the ground round it and round its partner."""
    if keypoint.match is None:
        kind, words = "unmatched", dict(KIND_NAMES)["unmatched"]
    else:
        kind, missed = describe_match(result, keypoint.match)
        words = f"{kind} {keypoint.match + 1} · descriptors differ by "
        words += f"{result.matches.distances[keypoint.match]:.2f}"
        if missed is not None:
            words += f" · {missed:.2f} m off"
    patches = gradient_patches(result, _ends(result, keypoint))
    low, high = 0.0, max(1e-9, *(float(patch.max()) for _, patch in patches))
    state = picture.state
    names = state.query_id, state.database_id
    pictures = "".join(
        f'<figure style="margin:0;text-align:center"><img alt="gradient round the keypoint of the '
        f'{ROLES[index]}" width="{PATCH + 24}" height="{PATCH + 24}" style="display:block" '
        f'src="{png_uri(colorize(patch.ravel(), low, high, "grey").reshape(*patch.shape, 3))}">'
        f"<figcaption>{ROLES[index]} {escape(names[index])}</figcaption></figure>"
        for index, patch in patches
    )
    return (
        f"<div>{mark_svg(kind, inlier_color(result))} {escape(words)}</div>"
        f'<div style="display:flex;gap:8px;margin-top:4px">{pictures}</div>'
    )


def gradient_patches(
    result: PairResult, ends: list[tuple[int, int]]
) -> list[tuple[int, Float[Array, "side side"]]]:
    """Cut the ground round keypoints out of their gradient maps [m/m], as the database lies.

    With a motion, the query's patch is turned by it. An end is the query (0) or the database (1),
    and the number of its keypoint; the first row of a patch is the farthest along y.
    """
    motion = result.registration.T_database_query
    features = result.features
    half = PATCH_SCALES * max(float(features[index].scales[number]) for index, number in ends)
    steps = np.linspace(-half, half, PATCH)
    across, along = np.meshgrid(steps, steps[::-1])
    patches: list[tuple[int, Float[Array, "side side"]]] = []
    for index, number in ends:
        yaw = motion.yaw if motion is not None and index == 0 else 0.0
        c, s = np.cos(yaw), np.sin(yaw)
        x, y = features[index].positions[number]
        xy = np.column_stack(
            [(x + c * across + s * along).ravel(), (y - s * across + c * along).ravel()]
        )
        gradient_map = result.maps[index]
        values = sample(gradient_map.gradient, gradient_map.grid.to_pixel(xy))
        patches.append((index, np.nan_to_num(values).reshape(PATCH, PATCH)))
    return patches


def reading_card(picture: Picture, probe: Probe) -> str:
    """Write elevation, its standard deviation and slope of a place, in both submaps if possible."""
    state, here = picture.state, ROLES.index(probe.role)
    names = f"query {state.query_id}", f"database {state.database_id}"
    if not state.is_pair:
        names = f"submap {state.query_id}", ""
    rows: list[str] = []
    for index, reading in enumerate(picture.readings(probe)):
        if index != here and picture.motion is None:
            continue
        words = "saw no ground there"
        if reading is not None and (reading.trusted or index == here):
            words = label_text(reading) + ("" if reading.trusted else " · masked")
        weight = 600 if index == here else 400
        rows.append(
            f'<div style="font-weight:{weight}"><span style="display:inline-block;'
            f'min-width:7.2em">{escape(names[index])}</span>{escape(words)}</div>'
        )
    return "".join(rows)
