"""Colour maps, hillshade and the legend: numbers to the colours that the screen shows."""

from functools import cache
from typing import TypeAlias

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from app.viewer.charts import png_uri
from app.viewer.session.layers import ColorMap
from gpgrad_core.arrays import NDArray
from gpgrad_core.display import LIGHT
from gpgrad_core.errors import InputError

Colors = UInt8[NDArray[np.uint8], "n 3"]
Rgb: TypeAlias = tuple[int, int, int]

QUERY = (31, 119, 200)
DATABASE = (222, 120, 20)
INLIER = (70, 196, 110)
REFUSED_INLIER = (236, 178, 40)
OUTLIER = (186, 36, 58)
"""Far darker than inliers, so that eyes that see no red and no green tell them apart."""
INK, PAPER = (18, 20, 24), (250, 248, 244)
"""Of marks: each has both, and so is visible on light and on dark ground."""
CHOSEN = (0, 200, 230)
PROBE = (230, 40, 200)
BACK = (165, 165, 165)
"""Where the colour of what steps back fades to: a grey that light and dark pages show alike."""
UNTRUSTED_GREY = (186, 186, 186)

AMBIENT = 0.3
FILL, FILL_SHARE = (0.6, 0.35, 0.72), 0.3
"""Towards a second, weaker light, which gives slopes along the first one a shape, and its share."""
BRIGHTNESS = 0.299 / 255, 0.587 / 255, 0.114 / 255
"""Of red, green and blue of a colour."""
DARKEST, PALEST = 0.15, 0.75
"""Of a tint: how much of it is in what was black, and how pure it is in what was white."""

# Blue is down, white level, red up; dark ends, so that steep slopes stand out on a white page.
_BLUE_WHITE_RED = np.array(
    [(20, 50, 120), (66, 130, 196), (240, 240, 240), (214, 96, 77), (120, 10, 30)]
)

_PERCEPTUAL = {
    # Level ground is light and steep ground dark: shaded relief is visible on both.
    "ember": [(226, 219, 203), (240, 196, 132), (232, 132, 76), (190, 58, 74), (104, 26, 84)],
    # From hollows to heights; neither end is the black or the white of a page.
    "mesa": [(46, 52, 108), (30, 112, 138), (104, 164, 134), (224, 194, 124), (242, 228, 200)],
    # From shadow to sand, and muted: of a map from which tracks and arcs stand out.
    "regolith": [(81, 71, 93), (135, 100, 99), (181, 135, 107), (215, 175, 133), (243, 217, 179)],
}
"""Colours from the low end to the high one, between which equal steps look equal."""

_ACES_IN = np.array(
    [[0.59719, 0.35458, 0.04823], [0.07600, 0.90834, 0.01566], [0.02840, 0.13383, 0.83777]]
)
_ACES_OUT = np.array(
    [[1.60475, -0.53108, -0.07367], [-0.10208, 1.10813, -0.00605], [-0.00327, -0.07276, 1.07602]]
)


@cache
def lookup_table(name: ColorMap) -> UInt8[NDArray[np.uint8], "256 3"]:
    """The 256 sRGB colours of a colour map, from its low end to its high end."""
    ramp = np.arange(256, dtype=np.uint8)
    of_opencv = getattr(cv2, f"COLORMAP_{name.upper()}", None)
    if of_opencv is not None:
        colors = cv2.applyColorMap(ramp[:, None], of_opencv)[:, 0, ::-1]
    elif name == "grey":
        colors = np.stack([np.linspace(30, 240, 256).round()] * 3, axis=1)
    elif name in _PERCEPTUAL:
        colors = _even(np.array([_PERCEPTUAL[name]], dtype=np.float32))
    elif name in ("blue-white-red", "red-white-blue"):
        stops = np.linspace(0, 255, len(_BLUE_WHITE_RED))
        places = ramp[::-1] if name == "red-white-blue" else ramp
        colors = np.stack(
            [np.interp(places, stops, channel).round() for channel in _BLUE_WHITE_RED.T], axis=1
        )
    else:
        raise InputError(f"no colour map is named {name!r}")
    table = np.ascontiguousarray(colors, dtype=np.uint8)
    table.flags.writeable = False
    return table


def _even(stops: Float[NDArray[np.float32], "1 k 3"]) -> Float[NDArray[np.float32], "256 3"]:
    """Interpolate colours in CIELAB so that equal steps look equally far."""
    lab = cv2.cvtColor(stops / np.float32(255), cv2.COLOR_RGB2LAB)[0]
    far = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(lab, axis=0), axis=1))])
    places = np.linspace(0.0, far[-1], 256)
    even = np.stack([np.interp(places, far, channel) for channel in lab.T], axis=1)
    colors = cv2.cvtColor(even[None].astype(np.float32), cv2.COLOR_LAB2RGB)[0]
    return (255.0 * colors).round().clip(0, 255)


def colorize(
    values: Float[NDArray[np.floating], "n"], low: float, high: float, name: ColorMap
) -> Colors:
    """Colour values by their place between low and high; those beyond take the end colours."""
    span = max(high - low, 1e-12)
    places = np.clip((values - low) * (255.0 / span), 0.0, 255.0)
    return lookup_table(name).take(places.astype(np.uint8), axis=0)


def hillshade(
    slope: Float[NDArray[np.floating], "n 2"], yaw: float = 0.0
) -> Float[NDArray[np.floating], "n"]:
    """The brightness of ground of a slope (dz/dx, dz/dy) [m/m], level ground being 1.

    The yaw is that of the submap's frame in the scene [rad]: the light stays with the scene, so
    that two submaps on top of each other are lit alike.
    """
    c, s = float(np.cos(yaw)), float(np.sin(yaw))
    along_x, along_y = slope[..., 0], slope[..., 1]
    upright = 1.0 / np.sqrt(1.0 + along_x * along_x + along_y * along_y)
    bright = np.full_like(upright, AMBIENT)
    for (x, y, z), share in ((LIGHT, 1.0 - FILL_SHARE), (FILL, FILL_SHARE)):
        facing = (1.0 - along_x * ((c * x + s * y) / z) - along_y * ((c * y - s * x) / z)) * upright
        bright += (1.0 - AMBIENT) * share * np.clip(facing, 0.0, 1.4, out=facing)
    return bright


def shade(colors: Colors, brightness: Float[NDArray[np.floating], "n"]) -> Colors:
    """Darken colours towards black, or brighten them towards white, where brightness is above 1."""
    dark = np.minimum(brightness, 1.0).astype(np.float32)[:, None]
    light = np.clip(255.0 * (brightness - 1.0), 0.0, 255.0).astype(np.float32)[:, None]
    lit = colors * (dark - light / np.float32(255))
    lit += light
    return lit.astype(np.uint8)


def tinted(colors: Colors, tint: Rgb) -> Colors:
    """Colours in one hue; as light and as dark as they were, they mean the same."""
    light = (colors @ np.array(BRIGHTNESS, dtype=np.float32))[:, None]
    darkest, hue = DARKEST * np.array(tint), 255.0 - PALEST * (255.0 - np.array(tint))
    return (darkest + light * (hue - darkest)).astype(np.uint8)


def faint(color: Rgb) -> Rgb:
    """Fade a colour for what steps back, on a light and on a dark page alike."""
    red, green, blue = (
        int(0.3 * channel + 0.7 * grey) for channel, grey in zip(color, BACK, strict=True)
    )
    return red, green, blue


def faded(colors: Colors) -> Colors:
    """Fade colours as `faint` does one; they keep a part of their light."""
    light = (colors @ np.array(BRIGHTNESS, dtype=np.float32))[:, None]
    return (np.array(BACK) * (0.55 + 0.55 * light)).clip(0, 255).astype(np.uint8)


def css(color: Rgb) -> str:
    """Write a colour for a page.

    >>> css((1, 20, 255))
    'rgb(1,20,255)'
    """
    red, green, blue = color
    return f"rgb({red},{green},{blue})"


def for_lines(color: Rgb) -> NDArray[np.uint8]:
    """The colour (3,) that lines of one colour need so that the browser shows ``color``.

    The browser decodes such a colour to linear light and then tone-maps it like a film (three's
    ACESFilmicToneMapping), which washes it out; this goes that way backwards. Point clouds
    are spared the tone mapping and need nothing.
    """
    light = _light_of(np.array(color, np.uint8))
    encoded = np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)
    return np.round(255.0 * encoded).astype(np.uint8)


def for_line_ends(colors: Colors) -> UInt8[NDArray[np.uint8], "n 2 3"]:
    """As `for_lines`, for both ends of lines with colours of their own, read as linear light."""
    return np.round(255.0 * _light_of(colors)).astype(np.uint8)[:, None].repeat(2, axis=1)


def _light_of(colors: UInt8[NDArray[np.uint8], "*n 3"]) -> Float[NDArray[np.float64], "*n 3"]:
    """The linear light that the browser's tone mapping turns into an sRGB colour."""
    srgb = colors / 255.0
    linear = np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)
    # ACES: three steps, colour mixing, a curve (a v² + b v + c) / (d v² + e v + f) with the
    # numbers below, and mixing again; each is undone, the curve by its quadratic.
    toned = linear @ np.linalg.inv(_ACES_OUT).T
    a = 1.0 - 0.983729 * toned
    b = 0.0245786 - 0.4329510 * toned
    c = -0.000090537 - 0.238081 * toned
    curve = (-b + np.sqrt(np.maximum(b * b - 4.0 * a * c, 0.0))) / (2.0 * a)
    return np.clip(0.6 * curve @ np.linalg.inv(_ACES_IN).T, 0.0, 1.0)


def legend_uri(bars: UInt8[NDArray[np.uint8], "bars 256 3"]) -> str:
    """Draw colours as bars one above the other, as a ``data:`` address of a PNG, low end left."""
    return png_uri(bars.repeat(12 // len(bars), axis=0))
