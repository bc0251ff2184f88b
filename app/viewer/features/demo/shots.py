"""The steps of a pair as pictures of one size, drawn without a page: for films and slides."""

from collections.abc import Iterator
from dataclasses import replace

import cv2
import numpy as np
from jaxtyping import UInt8
from matplotlib.figure import Figure

from app.viewer.features.demo.steps import FADE, FLIGHT, motion_between
from app.viewer.features.pair import PairDrawing, boxes_of, compose
from app.viewer.features.save.figures import Sheet, draw_picture, pixels_of
from app.viewer.features.save.views import ground_of, written_of
from app.viewer.scene.cameras import DOWN, blend, ease
from app.viewer.scene.placement import BareCanvas, all_corners_of, frame_camera, glide
from app.viewer.scene.raster import Drawing, rasterise
from app.viewer.session.keyframes import Keyframe
from app.viewer.session.state import FROM_ABOVE, Camera, ViewState
from gpgrad_core.arrays import NDArray
from gpgrad_core.detection import PairResult
from gpgrad_core.run.memo import Memo

Shot = UInt8[NDArray[np.uint8], "_rows _columns 3"]
"""A picture; each has a size of its own."""
STANDS, LANDS, MIXES = 2.1, 1.4, 0.3
"""How long a step stands in a film, one after which the query has come, and two mix [s]."""
USUAL_UNIT = 8.1
"""Pixels of a sheet's unit on a page of usual size, where marks and lines have their widths."""


class Shots:
    """The keyframes of a pair as pictures; those of the map are left out."""

    def __init__(
        self,
        state: ViewState,
        result: PairResult,
        keyframes: tuple[Keyframe, ...],
        sheet: Sheet,
        memo: Memo,
        dark: bool,
    ) -> None:
        self.keyframes = tuple(frame for frame in keyframes if frame.subject == "pair")
        self._state, self._result, self._sheet, self._dark = state, result, sheet, dark
        *_, width, height = sheet.area
        self._canvas = BareCanvas(width, height)
        self._drawings, self._cameras = list[PairDrawing](), list[Camera]()
        for frame in self.keyframes:
            asked = replace(state, options=frame.options)
            picture = compose(asked, result.maps, result.registration, memo, result=result)
            self._drawings.append(PairDrawing(picture, result))
            placed = tuple(zip(boxes_of(asked), picture.placements, strict=True))
            forward = DOWN if frame.options.layout == FROM_ABOVE else None
            framed = frame_camera(all_corners_of(placed), self._canvas, forward=forward)
            self._cameras.append(frame.camera or framed)

    def figure(self, k: int) -> Figure:
        """Draw a step as a slide, whose words stay words in a PDF."""
        return self._figure(k, self._view(self._drawings[k].at(), self._cameras[k]))

    def film(self, frames_a_second: float) -> Iterator[tuple[Shot, float, float]]:
        """Give each picture, how long it stands [s], and the share of the whole that is done."""
        last: Shot | None = None
        for k in range(len(self.keyframes)):
            sheet = pixels_of(self._figure(k, None))
            for drawing, camera, share in self._moments(k, frames_a_second):
                shot = self._paste(sheet, self._view(drawing, camera))
                yield shot, 1.0 / frames_a_second, (k + share) / len(self.keyframes)
            still = self._paste(sheet, self._view(self._drawings[k].at(), self._cameras[k]))
            if last is not None and not self._moves(k):
                count = round(MIXES * frames_a_second)
                for step in range(1, count):
                    mixed = cv2.addWeighted(last, 1 - step / count, still, step / count, 0.0)
                    yield (
                        np.asarray(mixed, np.uint8),
                        1.0 / frames_a_second,
                        k / len(self.keyframes),
                    )
            yield still, LANDS if self._moves(k) else STANDS, (k + 1) / len(self.keyframes)
            last = still

    def _moves(self, k: int) -> bool:
        if k == 0:
            return False
        before, after = (self.keyframes[j].options for j in (k - 1, k))
        return motion_between(before, after) != "turn" or self._cameras[k - 1] != self._cameras[k]

    def _moments(self, k: int, frames_a_second: float) -> Iterator[tuple[Drawing, Camera, float]]:
        """Give what leads from the step before to this one."""
        if not self._moves(k):
            return
        before, here = self._drawings[k - 1], self._drawings[k]
        motion = motion_between(self.keyframes[k - 1].options, self.keyframes[k].options)
        count = round((FLIGHT if motion == "flight" else FADE) * frames_a_second)
        box, start = boxes_of(self._state)[0], before.picture.placements
        for step in range(count):
            share = ease(step / count)
            placed, colors = here.picture.placements, None
            if motion == "flight":
                placed = glide(box, start, placed, share)
            elif motion == "fade":
                colors = _mixed(before, here, share)
            camera = blend(self._cameras[k - 1], self._cameras[k], share)
            yield here.at(placed, colors), camera, step / count

    def _view(self, drawing: Drawing, camera: Camera) -> Shot:
        ground = ground_of(self._dark)
        return rasterise(drawing, camera, self._canvas, ground, self._sheet.unit / USUAL_UNIT)

    def _figure(self, k: int, view: Shot | None) -> Figure:
        frame, camera = self.keyframes[k], self._cameras[k]
        words = frame.title, frame.line
        written = written_of(
            self._drawings[k],
            self._result,
            camera,
            self._canvas,
            words,
            self._dark,
        )
        return draw_picture(view, written, self._sheet)

    def _paste(self, sheet: Shot, view: Shot) -> Shot:
        shot, (x, y, width, height) = sheet.copy(), self._sheet.area
        shot[y : y + height, x : x + width] = view
        return shot


def _mixed(
    before: PairDrawing, here: PairDrawing, share: float
) -> tuple[NDArray[np.uint8], ...] | None:
    """Mix the colours of both steps; None if they have other cells."""
    pairs = [(a.colors, b.colors) for a, b in zip(before.surfels, here.surfels, strict=True)]
    if any(a.shape != b.shape for a, b in pairs):
        return None
    return tuple(((1 - share) * a + share * b).round().astype(np.uint8) for a, b in pairs)
