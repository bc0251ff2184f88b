"""Films and slides of a story, drawn without a page: GIF, WebM and MP4; PDF and PNG."""

import shutil
import subprocess
import zipfile
from collections import deque
from collections.abc import Callable, Generator, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import closing
from dataclasses import replace
from functools import partial
from io import BytesIO
from itertools import chain
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import UInt8
from matplotlib.backends.backend_pdf import PdfPages
from matplotlib.figure import Figure
from PIL import Image

from app.viewer.features.demo.story import MOTION_SECONDS, Motion, motion_between
from app.viewer.features.pair import PairDrawing, boxes_of, compose
from app.viewer.features.save.figures import (
    LETTERS_STAY,
    Sheet,
    Written,
    draw_picture,
    ground_of,
    pixels_of,
    written_of,
)
from app.viewer.scene.cameras import DOWN, blend, ease
from app.viewer.scene.placement import BareCanvas, Canvas, frame_camera, glide
from app.viewer.scene.raster import rasterise
from app.viewer.session.session_file import Keyframe
from app.viewer.session.state import FROM_ABOVE, Camera, ViewState
from gpgrad_core.arrays import NDArray
from gpgrad_core.detection import PairResult
from gpgrad_core.errors import InputError
from gpgrad_core.run import Progress
from gpgrad_core.run.memo import Memo
from gpgrad_core.run.threads import own_threads

FILM, GIF, SLIDE = (1280, 720), (960, 540), (1920, 1080)
"""Pixels; a GIF of more would be too large to send."""
FILM_RATE, GIF_RATE = 24.0, 10.0
"""Pictures a second."""
Shot = UInt8[NDArray[np.uint8], "_rows _columns 3"]
"""A picture; each has a size of its own."""
STANDS, LANDS, MIXES = 2.1, 1.4, 0.3
"""How long a step stands in a film, one after which the query has come, and two mix [s]."""
AHEAD = 24
"""Pictures of a film that may be drawn before their turn."""
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
        canvas: Canvas | None = None,
    ) -> None:
        """Draw on sheets; the cameras fill their pictures, or another canvas."""
        self.keyframes = tuple(frame for frame in keyframes if frame.subject == "pair")
        self.state, self.result, self._sheet, self._dark = state, result, sheet, dark
        *_, width, height = sheet.area
        self._canvas = canvas or BareCanvas(width, height)
        self._drawings, self.cameras = list[PairDrawing](), list[Camera]()
        for frame in self.keyframes:
            asked = replace(state, options=frame.options)
            picture = compose(asked, result.maps, result.registration, memo, result=result)
            self._drawings.append(PairDrawing(picture, result))
            placed = tuple(zip(boxes_of(asked), picture.placements, strict=True))
            forward = DOWN if frame.options.layout == FROM_ABOVE else None
            framed = frame_camera(placed, self._canvas, forward=forward)
            self.cameras.append(frame.camera or framed)

    def figure(self, k: int) -> Figure:
        """Draw a step as a slide, whose words stay words in a PDF."""
        return self._figure(k, self._view(k))

    def film(self, frames_a_second: float) -> Generator[tuple[Shot, float, float]]:
        """Yield each picture, how long it stands [s], and the share of the whole that is done.

        Threads draw the next ones meanwhile.
        """
        waiting = deque[tuple[Future[Shot], float, float]]()
        with own_threads() as threads:
            for draw, seconds, done in self._pictures(frames_a_second, threads):
                waiting.append((threads.submit(draw), seconds, done))
                if len(waiting) > AHEAD:
                    first = waiting.popleft()
                    yield first[0].result(), *first[1:]
            while waiting:
                first = waiting.popleft()
                yield first[0].result(), *first[1:]

    def _pictures(
        self, frames_a_second: float, threads: ThreadPoolExecutor
    ) -> Iterator[tuple[Callable[[], Shot], float, float]]:
        """Yield what draws each picture, how long that stands, and the share that is done."""
        whole, step, last = len(self.keyframes), 1.0 / frames_a_second, None
        for k in range(whole):
            sheet = pixels_of(self._figure(k, None))
            moves = self.moves(k)
            seconds = MOTION_SECONDS[self.motion(k)] if moves else MIXES if k else 0.0
            shares = np.linspace(0.0, 1.0, round(seconds * frames_a_second), endpoint=False)
            # Threads begin in order: what waits for a still waits for one that is being drawn.
            still = threads.submit(self._shot, sheet, k)
            for share in shares.tolist():
                mix = None if moves or last is None else partial(_mix, last, still, share)
                yield mix or partial(self._shot, sheet, k, ease(share)), step, (k + share) / whole
            yield still.result, LANDS if moves else STANDS, (k + 1) / whole
            last = still

    def motion(self, k: int) -> Motion:
        """What moves on the way to a step; to the first, nothing but the camera."""
        return motion_between(self.keyframes[max(k - 1, 0)].options, self.keyframes[k].options)

    def moves(self, k: int) -> bool:
        return k > 0 and (self.motion(k) != "turn" or self.cameras[k - 1] != self.cameras[k])

    def _shot(self, sheet: Shot, k: int, share: float = 1.0) -> Shot:
        shot, (x, y, width, height) = sheet.copy(), self._sheet.area
        shot[y : y + height, x : x + width] = self._view(k, share)
        return shot

    def _view(self, k: int, share: float = 1.0) -> Shot:
        """Draw a step, or what is visible at a share of the way that leads to it."""
        here, camera = self._drawings[k], self.cameras[k]
        placed, colors = here.picture.placements, None
        if share < 1.0:
            before, motion = self._drawings[k - 1], self.motion(k)
            if motion == "flight":
                box = boxes_of(self.state)[0]
                placed = glide(box, before.picture.placements, placed, share)
            elif motion == "fade":
                colors = _mixed(before, here, share)
            camera = blend(self.cameras[k - 1], camera, share)
        ground, times = ground_of(self._dark), self._sheet.unit / USUAL_UNIT
        return rasterise(here.at(placed, colors), camera, self._canvas, ground, times)

    def _figure(self, k: int, view: Shot | None) -> Figure:
        return draw_picture(view, self.written(k), self._sheet)

    def written(self, k: int) -> Written:
        """The words beside a step."""
        words = self.keyframes[k].title, self.keyframes[k].line
        drawing, camera = self._drawings[k], self.cameras[k]
        return written_of(drawing, self.result, camera, self._canvas, words, self._dark)


def _mix(before: Future[Shot], after: Future[Shot], share: float) -> Shot:
    mixed = cv2.addWeighted(before.result(), 1.0 - share, after.result(), share, 0.0)
    return np.asarray(mixed, np.uint8)


def _mixed(
    before: PairDrawing, here: PairDrawing, share: float
) -> tuple[NDArray[np.uint8], ...] | None:
    """Mix the colours of both steps; None if they have other cells."""
    pairs = [(a.colors, b.colors) for a, b in zip(before.surfels, here.surfels, strict=True)]
    if any(a.shape != b.shape for a, b in pairs):
        return None
    return tuple(((1 - share) * a + share * b).round().astype(np.uint8) for a, b in pairs)


def write_steps(
    state: ViewState,
    result: PairResult,
    keyframes: tuple[Keyframe, ...],
    memo: Memo,
    dark: bool,
    path: Path,
    progress: Progress,
) -> None:
    """Write the steps of a pair as a film or as slides, by the path's ending."""
    is_slides = path.suffix in (".pdf", ".zip")
    size = SLIDE if is_slides else GIF if path.suffix == ".gif" else FILM
    shots = Shots(state, result, keyframes, Sheet(*size), memo, dark)
    (_write_slides if is_slides else _write_film)(shots, path, progress)


def _write_film(shots: Shots, path: Path, progress: Progress) -> None:
    """Film the steps, in the format of the path's ending."""
    rate = GIF_RATE if path.suffix == ".gif" else FILM_RATE

    def film() -> Iterator[tuple[UInt8[NDArray[np.uint8], "rows columns 3"], float]]:
        with closing(shots.film(rate)) as pictures:  # so that its threads end with it
            for shot, seconds, done in pictures:
                progress(0.95 * done)
                yield shot, seconds

    if path.suffix == ".gif":
        pictures, seconds = zip(*((Image.fromarray(shot), s) for shot, s in film()), strict=True)
        durations = [round(1000 * value) for value in seconds]  # [ms]
        pictures[0].save(
            path, save_all=True, append_images=pictures[1:], duration=durations, loop=0
        )
        return
    frames = chain.from_iterable([shot] * max(round(s * rate), 1) for shot, s in film())
    if path.suffix == ".mp4" and shutil.which("ffmpeg"):
        _write_h264(frames, path)
        return
    code = cv2.VideoWriter.fourcc(*("mp4v" if path.suffix == ".mp4" else "VP80"))
    writer = cv2.VideoWriter(str(path), code, rate, FILM)
    if not writer.isOpened():
        raise InputError(f"this machine cannot write {path.suffix[1:]}; choose another format")
    try:
        for frame in frames:
            writer.write(np.ascontiguousarray(frame[..., ::-1]))
    finally:
        writer.release()


def _write_h264(frames: Iterator[UInt8[NDArray[np.uint8], "rows columns 3"]], path: Path) -> None:
    command = (
        f"ffmpeg -loglevel error -y -f rawvideo -pix_fmt rgb24 -s {FILM[0]}x{FILM[1]} "
        f"-r {FILM_RATE:g} -i - -pix_fmt yuv420p -movflags +faststart"
    ).split()
    with subprocess.Popen(
        [*command, str(path)], stdin=subprocess.PIPE, stderr=subprocess.PIPE
    ) as process:
        assert process.stdin is not None
        assert process.stderr is not None
        try:
            for frame in frames:
                process.stdin.write(frame.tobytes())
            process.stdin.close()
        except BrokenPipeError:
            pass  # it says why below
        except BaseException:
            process.kill()
            raise
        lines = process.stderr.read().decode(errors="replace").strip().splitlines()
    if process.returncode:
        raise InputError(f"ffmpeg could not write the film: {lines[-1] if lines else 'no reason'}")


def _write_slides(shots: Shots, path: Path, progress: Progress) -> None:
    """Write a slide for each step: pages of a PDF, or PNG files in a zip."""
    count = len(shots.keyframes)
    if path.suffix == ".pdf":
        with LETTERS_STAY(), PdfPages(path) as pages:
            for k in range(count):
                progress(k / count)
                pages.savefig(shots.figure(k))
        return
    with zipfile.ZipFile(path, "w") as archive:
        for k in range(count):
            progress(k / count)
            slide = BytesIO()
            shots.figure(k).savefig(slide, format="png")
            archive.writestr(f"{k + 1:02}.png", slide.getvalue())
