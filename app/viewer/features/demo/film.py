"""Films and slides of a story: GIF, WebM and MP4; PDF and PNG."""

import shutil
import subprocess
import zipfile
from collections.abc import Iterator
from contextlib import closing
from io import BytesIO
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np
from jaxtyping import UInt8
from PIL import Image

from app.viewer.session.keyframes import Keyframe
from app.viewer.session.state import ViewState
from gpgrad_core.arrays import NDArray
from gpgrad_core.detection import PairResult
from gpgrad_core.errors import InputError
from gpgrad_core.run import Progress
from gpgrad_core.run.memo import Memo

if TYPE_CHECKING:
    from app.viewer.features.demo.shots import Shots

FILM, GIF, SLIDE = (1280, 720), (960, 540), (1920, 1080)
"""Pixels; a GIF of more would be too large to send."""
FILM_RATE, GIF_RATE = 24.0, 10.0
"""Pictures a second."""
FILMS = {"MP4": ".mp4", "WebM": ".webm", "GIF": ".gif"}
"""Ending by format. MP4 is of the kind that every page plays where ffmpeg is installed."""
SLIDES = {"PDF": ".pdf", "PNG": ".zip"}


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
    from app.viewer.features.demo.shots import Shots  # noqa: PLC0415 - loads matplotlib
    from app.viewer.features.save.figures import Sheet  # noqa: PLC0415

    is_slides = path.suffix in SLIDES.values()
    size = SLIDE if is_slides else GIF if path.suffix == ".gif" else FILM
    shots = Shots(state, result, keyframes, Sheet(*size), memo, dark)
    (_write_slides if is_slides else _write_film)(shots, path, progress)


def _write_film(shots: "Shots", path: Path, progress: Progress) -> None:
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


def _write_slides(shots: "Shots", path: Path, progress: Progress) -> None:
    """Write a slide for each step: pages of a PDF, or PNG files in a zip."""
    from matplotlib.backends.backend_pdf import PdfPages  # noqa: PLC0415 - loads slowly

    from app.viewer.features.save.figures import LETTERS_STAY  # noqa: PLC0415

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
