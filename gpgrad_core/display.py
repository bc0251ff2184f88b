"""What a notebook shows as the value of a cell: named values, tables and small pictures."""

import base64
from collections.abc import Sequence
from html import escape

import numpy as np
from jaxtyping import Bool, Float, UInt8

from gpgrad_core.arrays import Floats, Mask, NDArray

SIDE = 260
"""Longer side of a picture [pixels of the page]."""
LIGHT = (-0.5, 0.5, 0.7071067811865476)
"""Towards the light: from the upper left, as maps are lit, at 45 degrees."""
STYLE = "text-align:left;padding:.1em 1em .1em 0"


def card(
    title: str,
    rows: Sequence[tuple[str, str]] = (),
    *,
    pictures: Sequence[tuple[str, str]] = (),
    table: Sequence[Sequence[str]] = (),
    note: str = "",
) -> str:
    """Write HTML: values by name, pictures (caption, from `picture`), and a table with its head."""
    parts = [f"<b>{escape(title)}</b>"]
    if rows:
        parts.append(_table([(name, value) for name, value in rows]))
    if pictures:
        figures = "".join(
            f'<figure style="display:inline-block;margin:.4em 1em .4em 0">'
            f'<img src="{source}" alt="{escape(caption)}" style="max-width:{SIDE}px;'
            f'max-height:{SIDE}px;width:{SIDE}px;object-fit:contain">'
            f"<figcaption>{escape(caption)}</figcaption></figure>"
            for caption, source in pictures
        )
        parts.append(f"<div>{figures}</div>")
    if table:
        parts.append(_table(table, head=True))
    if note:
        parts.append(f"<div>{escape(note)}</div>")
    return f"<div>{''.join(parts)}</div>"


def _table(rows: Sequence[Sequence[str]], *, head: bool = False) -> str:
    lines: list[str] = []
    for k, row in enumerate(rows):
        kinds = ["th" if head and k == 0 else "td"] * len(row)
        cells = "".join(
            f'<{kind} style="{STYLE}">{escape(text)}</{kind}>'
            for kind, text in zip(kinds, row, strict=True)
        )
        lines.append(f"<tr>{cells}</tr>")
    return f'<table style="border-collapse:collapse">{"".join(lines)}</table>'


def shaded(slope: Float[Floats, "*cells 2"]) -> Float[Floats, "*cells"]:
    """Shade terrain: 0 in the dark to 1, where it faces the light."""
    x, y, z = LIGHT
    along_x, along_y = slope[..., 0], slope[..., 1]
    facing = (z - along_x * x - along_y * y) / np.sqrt(1.0 + along_x**2 + along_y**2)
    return np.clip(facing, 0.0, 1.0)


def picture(values: Float[Floats, "rows columns"], trusted: Bool[Mask, "rows columns"]) -> str:
    """Draw a field as an address with its picture in it; row 0 is below, the unknown is clear."""
    import cv2  # noqa: PLC0415 - loads slowly, and most programs show nothing

    every = max(1, max(values.shape) // (2 * SIDE) + 1)
    values, trusted = values[::-every, ::every], trusted[::-every, ::every]
    some = values[trusted] if trusted.any() else values.ravel()
    low, high = np.percentile(some, [1, 99])
    share = np.clip((values - low) / max(high - low, 1e-12), 0.0, 1.0)
    grey: UInt8[NDArray[np.uint8], "rows columns"] = np.rint(255 * share).astype(np.uint8)
    clear = np.where(trusted, 255, 0).astype(np.uint8)
    _, png = cv2.imencode(".png", np.dstack([grey, grey, grey, clear]))
    return f"data:image/png;base64,{base64.b64encode(png.tobytes()).decode('ascii')}"
