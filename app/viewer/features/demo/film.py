"""Films of a story: a GIF, or an MP4 where ffmpeg is installed."""

import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import viser
from jaxtyping import UInt8
from PIL import Image, ImageDraw, ImageFont

from app.viewer.features.demo.story import Story, StoryStep
from app.viewer.features.work import GROUND_AND_INK, view_of_page
from gpgrad_core.arrays import NDArray
from gpgrad_core.errors import InputError
from gpgrad_core.run import Progress

FRAMES_A_SECOND = 10
WIDEST = 960
"""Pixels across; a GIF of more is too large to send."""


def film_formats() -> dict[str, str]:
    """Give the ending of each format that this machine can write."""
    mp4 = {"MP4": ".mp4"} if shutil.which("ffmpeg") else {}
    return {"GIF": ".gif", **mp4}


def write_film(
    story: Story, page: viser.ClientHandle, dark: bool, path: Path, progress: Progress
) -> None:
    """Film the steps of the pair as a page shows them, in the format of the path's ending."""
    camera = page.camera
    share = min(1.0, WIDEST / camera.image_width)
    # Even, as MP4's usual colours need.
    width, height = (
        2 * max(round(share * side / 2), 1) for side in (camera.image_width, camera.image_height)
    )
    shots: list[tuple[Image.Image, float]] = []
    for step, seconds, done in story.film(FRAMES_A_SECOND, progress):
        view = view_of_page(page, width, height)
        shots.append((_shot(view, step, dark=dark), seconds))
        progress(0.95 * done)
    if path.suffix == ".gif":
        _write_gif(shots, path)
    else:
        _write_mp4(shots, path)


def _shot(
    view: UInt8[NDArray[np.uint8], "rows columns 4"], step: StoryStep, *, dark: bool
) -> Image.Image:
    """Lay a view on the ground of the page, and write the step's words as a lower third."""
    ground, ink = GROUND_AND_INK[dark]
    seen = Image.fromarray(view)
    shot = Image.new("RGBA", seen.size, ground)
    shot.alpha_composite(seen)
    width, height = shot.size
    large, small = max(width // 26, 9), max(width // 48, 8)
    pen = ImageDraw.Draw(shot)
    top = height - 2 * large - small
    for words, size, down in ((step.title, large, 0), (step.line, small, 1.3 * large)):
        pen.text(
            (width // 25, top + down),
            words,
            fill=ink,
            font=ImageFont.load_default(size),
            stroke_width=max(size // 10, 1),
            stroke_fill=ground,
        )
    return shot.convert("RGB")


def _write_gif(shots: list[tuple[Image.Image, float]], path: Path) -> None:
    first, *others = (shot for shot, _ in shots)
    durations = [round(1000 * seconds) for _, seconds in shots]  # [ms]
    first.save(path, save_all=True, append_images=others, duration=durations, loop=0)


def _write_mp4(shots: list[tuple[Image.Image, float]], path: Path) -> None:
    width, height = shots[0][0].size
    command = (
        f"ffmpeg -loglevel error -y -f rawvideo -pix_fmt rgb24 -s {width}x{height} "
        f"-r {FRAMES_A_SECOND} -i - -pix_fmt yuv420p -movflags +faststart"
    ).split()
    content = b"".join(_repeated(shots))
    ended = subprocess.run([*command, str(path)], input=content, capture_output=True, check=False)
    if ended.returncode:
        lines = ended.stderr.decode(errors="replace").strip().splitlines() or ["no reason given"]
        raise InputError(f"ffmpeg could not write the film: {lines[-1]}")


def _repeated(shots: list[tuple[Image.Image, float]]) -> Iterator[bytes]:
    for shot, seconds in shots:
        yield shot.tobytes() * max(round(seconds * FRAMES_A_SECOND), 1)
