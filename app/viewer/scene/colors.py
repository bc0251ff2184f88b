"""Colour maps, hillshade and the legend: numbers to the colours that the screen shows."""

from functools import cache
from typing import TypeAlias

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from app.viewer.charts import png_uri
from app.viewer.session.state import ColorMap
from gpgrad_core.arrays import NDArray
from gpgrad_core.display import LIGHT, shaded
from gpgrad_core.errors import InputError

Colors = UInt8[NDArray[np.uint8], "n 3"]
Rgb: TypeAlias = tuple[int, int, int]

QUERY = (31, 119, 200)
DATABASE = (222, 120, 20)
INLIER = (70, 196, 110)
REFUSED_INLIER = (236, 178, 40)
OUTLIER = (186, 36, 58)
"""Far darker than inliers, so that eyes that see no red and no green tell them apart."""
UNMATCHED = (120, 120, 120)
INK, PAPER = (18, 20, 24), (250, 248, 244)
"""Of marks: each has both, and so is seen on light and on dark ground."""
CHOSEN = (0, 200, 230)
PROBE = (230, 40, 200)
BACK = (165, 165, 165)
"""Where the colour of what steps back fades to: a grey that light and dark pages show alike."""
UNTRUSTED_GREY = (186, 186, 186)

AMBIENT = 0.35
BRIGHTNESS = 0.299 / 255, 0.587 / 255, 0.114 / 255
"""Of red, green and blue of a colour."""
DARKEST, PALEST = 0.15, 0.75
"""Of a tint: how much of it is in what was black, and how pure it is in what was white."""

# Blue is down, white level, red up; dark ends, so that steep slopes stand out on a white page.
_BLUE_WHITE_RED = np.array(
    [(20, 50, 120), (66, 130, 196), (240, 240, 240), (214, 96, 77), (120, 10, 30)]
)

# Level ground is light and steep ground dark: shaded relief is seen on the one and on the other.
_EMBER = np.array([(205, 208, 190), (236, 205, 128), (236, 142, 62), (190, 62, 62), (112, 24, 82)])

_ACES_IN = np.array(
    [[0.59719, 0.35458, 0.04823], [0.07600, 0.90834, 0.01566], [0.02840, 0.13383, 0.83777]]
)
_ACES_OUT = np.array(
    [[1.60475, -0.53108, -0.07367], [-0.10208, 1.10813, -0.00605], [-0.00327, -0.07276, 1.07602]]
)


@cache
def lookup_table(name: ColorMap) -> UInt8[NDArray[np.uint8], "256 3"]:
    """Give the 256 sRGB colours of a colour map, from its low end to its high end."""
    ramp = np.arange(256, dtype=np.uint8)
    of_opencv = getattr(cv2, f"COLORMAP_{name.upper()}", None)
    if of_opencv is not None:
        colors = cv2.applyColorMap(ramp[:, None], of_opencv)[:, 0, ::-1]
    elif name == "grey":
        colors = np.stack([np.linspace(30, 240, 256).round()] * 3, axis=1)
    elif name in ("blue-white-red", "red-white-blue", "ember"):
        table = _EMBER if name == "ember" else _BLUE_WHITE_RED
        stops = np.linspace(0, 255, len(table))
        places = ramp[::-1] if name == "red-white-blue" else ramp
        colors = np.stack(
            [np.interp(places, stops, channel).round() for channel in table.T], axis=1
        )
    else:
        raise InputError(f"no colour map is named {name!r}")
    table = np.ascontiguousarray(colors, dtype=np.uint8)
    table.flags.writeable = False
    return table


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
    """Say how bright ground of a given slope is, level ground being 1.

    Args:
        slope: (dz/dx, dz/dy) [m/m] in the submap's frame.
        yaw: Of the submap's frame in the scene [rad]: the light stays with the scene, so that
            two submaps laid onto each other are lit alike.
    """
    c, s = float(np.cos(yaw)), float(np.sin(yaw))
    x, y, z = LIGHT
    lit = np.minimum(shaded(slope, (c * x + s * y, c * y - s * x, z)) / z, 1.4)
    return AMBIENT + (1.0 - AMBIENT) * lit


def shade(colors: Colors, brightness: Float[NDArray[np.floating], "n"]) -> Colors:
    """Darken or brighten colours."""
    lit = np.multiply(colors, brightness[:, None], dtype=np.float32)
    return np.minimum(lit, 255.0, out=lit).astype(np.uint8)


def tinted(colors: Colors, tint: Rgb) -> Colors:
    """Give colours one hue; as light and as dark as they were, they mean the same."""
    light = (colors @ np.array(BRIGHTNESS, dtype=np.float32))[:, None]
    darkest, hue = DARKEST * np.array(tint), 255.0 - PALEST * (255.0 - np.array(tint))
    return (darkest + light * (hue - darkest)).astype(np.uint8)


def faint(color: Rgb) -> Rgb:
    """Fade a colour for what steps back, on a light and on a dark page alike."""
    red, green, blue = (
        int(0.3 * channel + 0.7 * grey) for channel, grey in zip(color, BACK, strict=True)
    )
    return red, green, blue


def css(color: Rgb) -> str:
    """Write a colour for a page.

    >>> css((1, 20, 255))
    'rgb(1,20,255)'
    """
    red, green, blue = color
    return f"rgb({red},{green},{blue})"


def for_lines(color: Rgb) -> NDArray[np.uint8]:
    """Give the colour (3,) that lines of one colour need so that the browser shows the wanted one.

    The browser decodes such a colour to linear light and then tone-maps it like a film (three's
    ACESFilmicToneMapping), which washes it out; this goes that way backwards. Point clouds
    are spared the tone mapping and need nothing.
    """
    light = _light_of(np.array(color, np.uint8))
    encoded = np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)
    return np.round(255.0 * encoded).astype(np.uint8)


def for_line_ends(colors: Colors) -> UInt8[NDArray[np.uint8], "n 2 3"]:
    """Give what `for_lines` gives, for both ends of lines that have colours of their own.

    The browser takes the colours of such lines for linear light already.
    """
    return np.round(255.0 * _light_of(colors)).astype(np.uint8)[:, None].repeat(2, axis=1)


def _light_of(colors: UInt8[NDArray[np.uint8], "*n 3"]) -> Float[NDArray[np.float64], "*n 3"]:
    """Give the linear light that the browser's tone mapping turns into an sRGB colour."""
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


def legend_uri(bars: UInt8[NDArray[np.uint8], "bars 256 3"], *, height: int = 12) -> str:
    """Draw colours as bars one above the other, as a ``data:`` address of a PNG, low end left."""
    return png_uri(bars.repeat(height // len(bars), axis=0))
