"""How different two colours look."""

import numpy as np

from gpgrad_core.arrays import Array, NDArray

_TO_XYZ = np.array(
    [
        (0.4124564, 0.3575761, 0.1804375),
        (0.2126729, 0.7151522, 0.0721750),
        (0.0193339, 0.1191920, 0.9503041),
    ]
)
_WHITE = _TO_XYZ.sum(axis=1)


def lab_of(srgb: NDArray[np.uint8]) -> Array:
    """Turn colours of a screen (n, 3) into CIE L*a*b* under D65 (n, 3)."""
    shares = srgb / 255.0
    linear = np.where(shares <= 0.04045, shares / 12.92, ((shares + 0.055) / 1.055) ** 2.4)
    t = linear @ _TO_XYZ.T / _WHITE
    f = np.where(t > (6 / 29) ** 3, np.cbrt(t), t / (3 * (6 / 29) ** 2) + 4 / 29)
    return np.column_stack(
        [116 * f[:, 1] - 16, 500 * (f[:, 0] - f[:, 1]), 200 * (f[:, 1] - f[:, 2])]
    )


def ciede2000(first: Array, second: Array) -> Array:
    """Compute the difference CIEDE2000 of L*a*b* (n, 3), as Sharma et al. (2005) write it."""
    (l1, a1, b1), (l2, a2, b2) = first.T, second.T
    mean_chroma = (np.hypot(a1, b1) + np.hypot(a2, b2)) / 2
    g = 0.5 * (1 - np.sqrt(mean_chroma**7 / (mean_chroma**7 + 25.0**7)))
    c1, c2 = np.hypot((1 + g) * a1, b1), np.hypot((1 + g) * a2, b2)
    h1 = np.degrees(np.arctan2(b1, (1 + g) * a1)) % 360
    h2 = np.degrees(np.arctan2(b2, (1 + g) * a2)) % 360
    both = c1 * c2 > 0
    turn = np.where(both, (h2 - h1 + 180) % 360 - 180, 0.0)
    delta_l, delta_c = l2 - l1, c2 - c1
    delta_h = 2 * np.sqrt(c1 * c2) * np.sin(np.radians(turn) / 2)
    lightness, c = (l1 + l2) / 2, (c1 + c2) / 2
    h = np.where(
        both, np.where(np.abs(h1 - h2) <= 180, (h1 + h2) / 2, (h1 + h2 + 360) / 2), h1 + h2
    )
    t = (
        1
        - 0.17 * np.cos(np.radians(h - 30))
        + 0.24 * np.cos(np.radians(2 * h))
        + 0.32 * np.cos(np.radians(3 * h + 6))
        - 0.20 * np.cos(np.radians(4 * h - 63))
    )
    s_l = 1 + 0.015 * (lightness - 50) ** 2 / np.sqrt(20 + (lightness - 50) ** 2)
    s_c, s_h = 1 + 0.045 * c, 1 + 0.015 * c * t
    around = 60 * np.exp(-(((h - 275) / 25) ** 2))
    r = -np.sin(np.radians(around)) * 2 * np.sqrt(c**7 / (c**7 + 25.0**7))
    light, chroma, hue = delta_l / s_l, delta_c / s_c, delta_h / s_h
    return np.sqrt(np.maximum(light**2 + chroma**2 + hue**2 + r * chroma * hue, 0.0))
