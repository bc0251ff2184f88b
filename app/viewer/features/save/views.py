"""Views of the scene as pixels, with what is to be written beside them."""

import numpy as np
import viser
from jaxtyping import UInt8
from matplotlib.colors import to_rgb

from app.viewer.features.pair import PairDrawing, compose
from app.viewer.features.save.figures import Written
from app.viewer.features.work import GROUND_AND_INK, view_of_page
from app.viewer.scene.associations import inlier_color, shown_counts
from app.viewer.scene.cameras import scale_bar, view_of
from app.viewer.scene.colors import Rgb
from app.viewer.scene.layers import Scale
from app.viewer.scene.placement import Canvas
from app.viewer.scene.raster import rasterise
from app.viewer.session.news import PairShown
from app.viewer.session.state import Camera
from gpgrad_core.arrays import NDArray
from gpgrad_core.detection import PairResult
from gpgrad_core.run.memo import Memo

View = UInt8[NDArray[np.uint8], "rows columns 3"]
Words = tuple[str, str]


def ground_of(dark: bool) -> Rgb:
    """The background of a picture."""
    red, green, blue = (round(255 * part) for part in to_rgb(GROUND_AND_INK[dark][0]))
    return red, green, blue


def pair_view(
    shown: PairShown,
    memo: Memo,
    camera: Camera,
    canvas: Canvas,
    words: Words,
    dark: bool,
    times: float,
) -> tuple[View, Written]:
    """Draw the pair without its page; marks and lines are so many times as wide as there."""
    state, result = shown
    drawing = PairDrawing(
        compose(state, result.maps, result.registration, memo, result=result), result
    )
    view = rasterise(drawing.at(), camera, canvas, ground_of(dark), times)
    return view, written_of(drawing, result, camera, canvas, words, dark)


def rendered_view(
    page: viser.ClientHandle, canvas: Canvas, words: Words, scale: Scale | None, dark: bool
) -> tuple[View, Written]:
    """What a page shows, drawn by it."""
    view = view_of_page(page, round(canvas.width), round(canvas.height))
    share = view[..., 3:] / 255.0
    mixed = view[..., :3] * share + np.array(ground_of(dark)) * (1.0 - share)
    written = Written(*words, scale_bar(view_of(page), canvas), scale, dark)
    return mixed.round().astype(np.uint8), written


def written_of(
    drawing: PairDrawing,
    result: PairResult,
    camera: Camera,
    canvas: Canvas,
    words: Words,
    dark: bool,
) -> Written:
    """What stands beside a view of the pair: title, line, scale bar, legend and marks."""
    picture, bar = drawing.picture, scale_bar(camera, canvas)
    counts = shown_counts(result, picture.state.options)
    return Written(*words, bar, picture.scale, dark, counts, inlier_color(result))
