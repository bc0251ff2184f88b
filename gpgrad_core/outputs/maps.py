"""Gradient maps as files: arrays (``.npz``), raster (``.tif``), picture (``.png``), mesh."""

from collections.abc import Mapping
from html import escape
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int, UInt8

from gpgrad_core.arrays import NDArray
from gpgrad_core.errors import InputError
from gpgrad_core.outputs.files import check_output, replacing
from gpgrad_core.types import Array, GradientMap, Grid

BgrImage = UInt8[NDArray[np.uint8], "height width 3"]
"""Blue, green, red, as OpenCV has it."""

Layer = Float[NDArray[np.floating], "rows columns"]

TILE = 256
"""Side of the squares of cells that a raster is written in."""
MAP_ENDINGS = (".npz", ".tif", ".tiff", ".png", ".ply", ".glb", ".obj")

PANEL_WIDTH, PANEL_HEIGHT = 460, 460
MARGIN, BAR_WIDTH, HEADER = 12, 14, 30
GEO_KEYS = (
    *(1, 1, 0, 3),  # version 1.1.0, three keys
    *(1024, 0, 1, 32767),  # the model is our own: a local frame
    *(1025, 0, 1, 1),  # a value stands for the area of its cell
    *(3076, 0, 1, 9001),  # in metres
)
INK, PAPER, UNSEEN = (40, 40, 40), (255, 255, 255), (205, 205, 205)


def write_map(
    path: Path | str, gradient_map: GradientMap, *, name: str = "", max_std_ratio: float = 0.3
) -> None:
    """Write a map in the format of the path's ending.

    Args:
        path: ``.npz``; ``.tif`` or ``.tiff``; ``.png``; ``.ply``, ``.glb`` or ``.obj`` for a mesh.
        gradient_map: What to write.
        name: Of the submap, for the picture's title.
        max_std_ratio: Cells less sure than this are left grey in the picture, and out of a mesh;
            files of numbers hold every cell.

    Raises:
        InputError: If the ending is another, the picture would be too large to draw, or the file
            cannot be written there.
        OSError: If writing fails.
    """
    path = check_output(path, MAP_ENDINGS)
    with replacing(path) as unfinished:
        match path.suffix.lower():
            case ".npz":
                write_arrays(unfinished, gradient_map.grid, _layers(gradient_map))
            case ".png":
                _write_picture(unfinished, draw_map(gradient_map, name, max_std_ratio))
            case ".ply" | ".glb" | ".obj":
                _write_mesh(unfinished, gradient_map, max_std_ratio)
            case _:
                write_raster(unfinished, gradient_map.grid, _layers(gradient_map))


def _layers(gradient_map: GradientMap) -> dict[str, Array]:
    """The layers, as every format names them."""
    return {
        "elevation": gradient_map.elevation,
        "variance": gradient_map.variance,
        "slope_x": gradient_map.slope[..., 0],
        "slope_y": gradient_map.slope[..., 1],
        "gradient": gradient_map.gradient,
    }


UNITS = {"elevation": "m", "variance": "m2", "slope_x": "m/m", "slope_y": "m/m", "gradient": "m/m"}


def write_arrays(path: Path, grid: Grid, layers: Mapping[str, Layer]) -> None:
    """Write layers and their grid as an NPZ; layers on disk are not brought into memory."""
    arrays = {"origin": np.asarray(grid.origin), "resolution": np.asarray(grid.resolution)}
    np.savez_compressed(path, **layers, **arrays)


def write_raster(path: Path, grid: Grid, layers: Mapping[str, Layer]) -> None:
    """Write one band a layer, north up, with GeoTIFF's tags for the scale and the place.

    The frame is local: there is no coordinate system to name. Geographic programs still take the
    cell size and the corner from the tags, and GDAL the names of the bands; NaN is no data.
    Layers on disk are read tile by tile.
    """
    import tifffile  # noqa: PLC0415 - for this format only; it would slow down every start

    rows, columns = grid.shape
    corner_x = grid.origin[0] - grid.resolution / 2
    corner_y = grid.origin[1] + (rows - 0.5) * grid.resolution
    items = "".join(
        f'<Item name="DESCRIPTION" sample="{band}" role="description">{escape(layer)}</Item>'
        f'<Item name="UNITTYPE" sample="{band}" role="unittype">{UNITS[layer]}</Item>'
        for band, layer in enumerate(layers)
    )
    tiles = (
        np.ascontiguousarray(layer[::-1][row : row + TILE, column : column + TILE], np.float32)
        for layer in layers.values()
        for row in range(0, rows, TILE)
        for column in range(0, columns, TILE)
    )
    tifffile.imwrite(
        path,
        tiles,
        shape=(len(layers), rows, columns),
        dtype=np.float32,
        tile=(TILE, TILE),
        photometric="minisblack",
        planarconfig="separate",
        compression="zlib",
        metadata=None,
        software="gpgrad",
        extratags=[
            (33550, "d", 3, (grid.resolution, grid.resolution, 0.0), True),  # ModelPixelScale
            (33922, "d", 6, (0.0, 0.0, 0.0, corner_x, corner_y, 0.0), True),  # ModelTiepoint
            (34735, "H", len(GEO_KEYS), GEO_KEYS, True),  # GeoKeyDirectory
            (42112, "s", 0, f"<GDALMetadata>{items}</GDALMetadata>", True),
            (42113, "s", 0, "nan", True),  # GDAL_NODATA
        ],
    )


def mesh_map(
    gradient_map: GradientMap, max_std_ratio: float
) -> tuple[Float[Array, "v 3"], Int[NDArray[np.intp], "f 3"]]:
    """Make the terrain's surface: a vertex a cell [m], two triangles a square of trusted cells.

    Raises:
        InputError: If no four neighbouring cells are trusted.
    """
    grid = gradient_map.grid
    trusted = gradient_map.trusted(max_std_ratio)
    whole = trusted[:-1, :-1] & trusted[:-1, 1:] & trusted[1:, :-1] & trusted[1:, 1:]
    if not whole.any():
        raise InputError(
            f"no part of the map is known to {max_std_ratio:g} of its signal_std: raise "
            "features.max_std_ratio, or the length-scale"
        )
    row, column = np.nonzero(whole)
    corner = row * grid.shape[1] + column
    right, above = corner + 1, corner + grid.shape[1]
    faces = np.concatenate(  # anticlockwise seen from above: normals point up
        [np.column_stack([corner, right, above]), np.column_stack([right, above + 1, above])]
    )
    vertices = np.column_stack([grid.positions, gradient_map.elevation.ravel()])
    used, renumbered = np.unique(faces, return_inverse=True)
    return vertices[used], renumbered.reshape(faces.shape)


def _write_mesh(path: Path, gradient_map: GradientMap, max_std_ratio: float) -> None:
    import trimesh  # noqa: PLC0415 - for this format only; it would slow down every start

    vertices, faces = mesh_map(gradient_map, max_std_ratio)
    trimesh.Trimesh(vertices, faces, process=False).export(path)


def _write_picture(path: Path, picture: BgrImage) -> None:
    done, png = cv2.imencode(".png", picture)
    if not done:
        raise OSError(f"{path}: OpenCV could not encode the picture")
    path.write_bytes(png.tobytes())


def draw_map(gradient_map: GradientMap, name: str = "", max_std_ratio: float = 0.3) -> BgrImage:
    """Draw the layers with their legends, for a person to look at; north is up.

    Args:
        gradient_map: What to draw.
        name: Of the submap, for the title.
        max_std_ratio: Cells less sure than this are left grey.

    Raises:
        InputError: If the map is too long and thin to draw.
    """
    trusted = gradient_map.trusted(max_std_ratio)
    seen = trusted if trusted.any() else np.ones_like(trusted)
    steepest = float(np.quantile(gradient_map.gradient[seen], 0.99)) or 1.0
    slope_x, slope_y = gradient_map.slope[..., 0], gradient_map.slope[..., 1]
    # Light from the north-west, 45 degrees high, as on paper maps.
    light = np.array([-1.0, 1.0, np.sqrt(2.0)]) / 2.0
    shade = (light[2] - slope_x * light[0] - slope_y * light[1]) / np.sqrt(
        1.0 + gradient_map.gradient**2
    )
    low, high = (float(np.quantile(gradient_map.elevation[seen], q)) for q in (0.005, 0.995))
    most = float(gradient_map.std.max())
    panels = [
        _panel("shaded relief", "", shade, (0.0, 1.0), seen=seen),
        _panel(
            "elevation",
            "m",
            gradient_map.elevation,
            (low, high),
            colour_map=cv2.COLORMAP_VIRIDIS,
            seen=seen,
        ),
        _panel(
            "standard deviation",
            "m",
            gradient_map.std,
            (0.0, most),
            colour_map=cv2.COLORMAP_CIVIDIS,
        ),
        _panel(
            "gradient",
            "m/m",
            gradient_map.gradient,
            (0.0, steepest),
            colour_map=cv2.COLORMAP_MAGMA,
            seen=seen,
        ),
        _panel(
            "dz/dx",
            "m/m",
            slope_x,
            (-steepest, steepest),
            colour_map=cv2.COLORMAP_TWILIGHT_SHIFTED,
            seen=seen,
        ),
        _panel(
            "dz/dy",
            "m/m",
            slope_y,
            (-steepest, steepest),
            colour_map=cv2.COLORMAP_TWILIGHT_SHIFTED,
            seen=seen,
        ),
    ]
    grid = gradient_map.grid
    rows, columns = grid.shape
    title = (
        f"{name}  {columns * grid.resolution:.4g} m x {rows * grid.resolution:.4g} m, "
        f"{columns} x {rows} cells of {grid.resolution:g} m; x right, y up; grey: std above "
        f"{max_std_ratio:g} of signal_std {gradient_map.signal_std:.3g} m"
    ).strip()
    body = np.vstack([np.hstack(panels[:3]), np.hstack(panels[3:])])
    header = np.full((HEADER + MARGIN, body.shape[1], 3), PAPER, np.uint8)
    _write(header, title, (MARGIN, HEADER), 0.55)
    return np.vstack([header, body])


def _panel(
    title: str,
    unit: str,
    layer: Array,
    limits: tuple[float, float],
    *,
    colour_map: int | None = None,
    seen: Bool[NDArray[np.bool_], "rows columns"] | None = None,
) -> BgrImage:
    """One layer with its title and legend, of one size for all."""
    low, high = limits
    span = max(high - low, 1e-12)
    rows, columns = layer.shape
    scale = min(PANEL_WIDTH / columns, PANEL_HEIGHT / rows)
    size = (round(columns * scale), round(rows * scale))
    if min(size) < 1:
        raise InputError(
            f"a map of {columns} x {rows} cells is too long and thin for a picture; "
            "write .npz or .tif"
        )
    colours = _coloured(np.clip((layer - low) / span, 0.0, 1.0), colour_map)
    if seen is not None:
        colours[~seen] = UNSEEN
    shrinking = cv2.INTER_AREA if scale < 1 else cv2.INTER_NEAREST
    # Row 0 is the lowest y; in a picture it is at the bottom.
    image = cv2.resize(np.ascontiguousarray(colours[::-1]), size, interpolation=shrinking)

    legend_width = BAR_WIDTH + 90
    panel = np.full(
        (HEADER + PANEL_HEIGHT + MARGIN, MARGIN + PANEL_WIDTH + MARGIN + legend_width, 3),
        PAPER,
        np.uint8,
    )
    _write(panel, f"{title} [{unit}]" if unit else title, (MARGIN, HEADER - 10), 0.55)
    panel[HEADER : HEADER + size[1], MARGIN : MARGIN + size[0]] = image
    if unit:
        bar_x = MARGIN + size[0] + MARGIN
        height = min(size[1], 240)
        ramp = np.linspace(1.0, 0.0, height)[:, None].repeat(BAR_WIDTH, axis=1)
        panel[HEADER : HEADER + height, bar_x : bar_x + BAR_WIDTH] = _coloured(ramp, colour_map)
        for share in (0.0, 0.5, 1.0):
            tick_y = HEADER + 10 + round((1.0 - share) * max(height - 10, 0))
            _write(panel, f"{low + share * span:.3g}", (bar_x + BAR_WIDTH + 6, tick_y), 0.45)
    return panel


def _coloured(shares: Array, colour_map: int | None) -> BgrImage:
    grey = np.round(shares * 255).astype(np.uint8)
    coloured = (
        cv2.cvtColor(grey, cv2.COLOR_GRAY2BGR)
        if colour_map is None
        else cv2.applyColorMap(grey, colour_map)
    )
    return np.asarray(coloured, dtype=np.uint8)


def _write(picture: BgrImage, text: str, corner: tuple[int, int], scale: float) -> None:
    """Write text into the picture; OpenCV's font has ASCII only."""
    ascii_text = text.encode("ascii", "replace").decode()
    cv2.putText(picture, ascii_text, corner, cv2.FONT_HERSHEY_SIMPLEX, scale, INK, 1, cv2.LINE_AA)
