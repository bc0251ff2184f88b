"""Gradient maps as arrays, rasters, pictures or meshes, and fitted parameters as TOML or tables."""

import csv
from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path

import cv2
import numpy as np
import tomli_w
from jaxtyping import Bool, Float, Int, UInt8

from gpgrad_core.arrays import NDArray
from gpgrad_core.display import shaded
from gpgrad_core.errors import InputError
from gpgrad_core.io.records.files import check_output, replacing
from gpgrad_core.mapping.fitting import FitResult, fitted_names
from gpgrad_core.mapping.gradient_map import TerrainParams
from gpgrad_core.params import bounds_of
from gpgrad_core.types import Array, GradientMap, Grid

BgrImage = UInt8[NDArray[np.uint8], "height width 3"]
"""A picture with OpenCV's order of colours: blue, green, red."""

Layer = Float[NDArray[np.floating], "rows columns"]

TILE = 256
"""Side of a raster's tiles [cells]."""
MAP_ENDINGS = (".npz", ".tif", ".tiff", ".png", ".ply", ".glb", ".obj")

PANEL_WIDTH, PANEL_HEIGHT = 460, 460
MARGIN, BAR_WIDTH, HEADER = 12, 14, 30
GEO_KEYS = (
    *(1, 1, 0, 3),  # version 1.1.0, three keys
    *(1024, 0, 1, 32767),  # a user-defined model: a local frame
    *(1025, 0, 1, 1),  # a value is that of its cell's area
    *(3076, 0, 1, 9001),  # lengths are in metres
)
INK, PAPER, UNSEEN = (40, 40, 40), (255, 255, 255), (205, 205, 205)
UNITS = {"elevation": "m", "variance": "m2", "slope_x": "m/m", "slope_y": "m/m", "gradient": "m/m"}


def write_map(
    path: Path | str, gradient_map: GradientMap, *, name: str = "", max_std_ratio: float = 0.3
) -> None:
    """Write a map in the format of the path's ending.

    Args:
        path: ``.npz``; ``.tif`` or ``.tiff``; ``.png``; ``.ply``, ``.glb`` or ``.obj`` for a mesh.
        gradient_map: The map to write.
        name: The submap's name, for the picture's title.
        max_std_ratio: Cells with a larger std / signal_std are grey in a picture and left out of a
            mesh; ``.npz`` and ``.tif`` files have every cell.

    Raises:
        InputError: If the ending is not one of these, the map is too long and thin for a picture,
            or the file cannot be written there.
        OSError: If writing fails.
    """
    path = check_output(path, MAP_ENDINGS)
    with replacing(path) as unfinished:
        match path.suffix.lower():
            case ".npz":
                write_arrays(unfinished, gradient_map.grid, layers_of(gradient_map))
            case ".png":
                done, png = cv2.imencode(".png", draw_map(gradient_map, name, max_std_ratio))
                if not done:
                    raise OSError(f"{path}: OpenCV could not encode the picture")
                unfinished.write_bytes(png.tobytes())
            case ".ply" | ".glb" | ".obj":
                import trimesh  # noqa: PLC0415 - for this format only; it loads slowly

                vertices, faces = mesh_map(gradient_map, max_std_ratio)
                if path.suffix.lower() != ".obj":
                    _check_digits(path, vertices, gradient_map.grid.resolution)
                trimesh.Trimesh(vertices, faces, process=False).export(unfinished)
            case _:
                write_raster(unfinished, gradient_map.grid, layers_of(gradient_map))


def _check_digits(path: Path, vertices: Array, resolution: float) -> None:
    """Refuse a mesh so far from its origin that its numbers of 32 bits move it by a tenth cell."""
    furthest = float(np.abs(vertices).max(initial=0.0))
    step = float(np.spacing(np.float32(furthest)))
    if step > 0.1 * resolution:
        raise InputError(
            f"{path}: numbers of 32 bits give places {furthest:,.0f} m away to {step:.2g} m only; "
            "write .obj, .npz or .tif"
        )


def layers_of(gradient_map: GradientMap) -> dict[str, Array]:
    """Name the layers; the names are the same in every format."""
    return {
        "elevation": gradient_map.elevation,
        "variance": gradient_map.variance,
        "slope_x": gradient_map.slope[..., 0],
        "slope_y": gradient_map.slope[..., 1],
        "gradient": gradient_map.gradient,
    }


def write_arrays(path: Path, grid: Grid, layers: Mapping[str, Layer]) -> None:
    """Write layers and their grid as an NPZ; memory-mapped layers are not read into memory."""
    arrays = {"origin": np.asarray(grid.origin), "resolution": np.asarray(grid.resolution)}
    np.savez_compressed(path, allow_pickle=False, **layers, **arrays)


def write_raster(path: Path, grid: Grid, layers: Mapping[str, Layer]) -> None:
    """Write one band per layer, north up, with GeoTIFF's tags for scale and position."""
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
    """Make vertices [m], one a cell, and triangles, anticlockwise from above, of trusted cells."""
    grid = gradient_map.grid
    trusted = gradient_map.trusted(max_std_ratio)
    whole = trusted[:-1, :-1] & trusted[:-1, 1:] & trusted[1:, :-1] & trusted[1:, 1:]
    if not whole.any():
        raise InputError(
            f"nowhere on the map is the standard deviation below {max_std_ratio:g} of signal_std: "
            "raise features.max_std_ratio, or the length-scale"
        )
    row, column = np.nonzero(whole)
    corner = row * grid.shape[1] + column
    right, above = corner + 1, corner + grid.shape[1]
    faces = np.concatenate(  # anticlockwise from above, so that normals point up
        [np.column_stack([corner, right, above]), np.column_stack([right, above + 1, above])]
    )
    vertices = np.column_stack([grid.positions, gradient_map.elevation.ravel()])
    used, renumbered = np.unique(faces, return_inverse=True)
    return vertices[used], renumbered.reshape(faces.shape)


def draw_map(gradient_map: GradientMap, name: str = "", max_std_ratio: float = 0.3) -> BgrImage:
    """Draw the layers with legends, north up; cells with a larger std / signal_std are grey."""
    trusted = gradient_map.trusted(max_std_ratio)
    shown = trusted if trusted.any() else np.ones_like(trusted)
    elevation, std, gradient = gradient_map.elevation, gradient_map.std, gradient_map.gradient
    slope_x, slope_y = gradient_map.slope[..., 0], gradient_map.slope[..., 1]
    low, high = (float(np.quantile(elevation[shown], q)) for q in (0.005, 0.995))
    steepest = float(np.quantile(gradient[shown], 0.99)) or 1.0
    slopes = (-steepest, steepest), cv2.COLORMAP_TWILIGHT_SHIFTED, shown
    panels = [
        _draw(
            "shaded relief",
            "",
            shaded(gradient_map.slope).astype(np.float64),
            (0.0, 1.0),
            None,
            shown,
        ),
        _draw("elevation", "m", elevation, (low, high), cv2.COLORMAP_VIRIDIS, shown),
        _draw("standard deviation", "m", std, (0.0, float(std.max())), cv2.COLORMAP_CIVIDIS),
        _draw("gradient", "m/m", gradient, (0.0, steepest), cv2.COLORMAP_MAGMA, shown),
        _draw("dz/dx", "m/m", slope_x, *slopes),
        _draw("dz/dy", "m/m", slope_y, *slopes),
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


def _draw(
    title: str,
    unit: str,
    layer: Array,
    limits: tuple[float, float],
    colour_map: int | None,
    shown: Bool[NDArray[np.bool_], "rows columns"] | None = None,
) -> BgrImage:
    """Draw a layer with title and legend; what is not shown is grey, as all without colours is."""
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
    if shown is not None:
        colours[~shown] = UNSEEN
    shrinking = cv2.INTER_AREA if scale < 1 else cv2.INTER_NEAREST
    # Row 0 has the lowest y, which is at the bottom of a picture.
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


def write_fitted(path: Path | str, result: FitResult) -> None:
    """Write the fitted hyperparameters and the noise model that they belong to.

    Args:
        path: File to write: a table ``[map]``, six digits per value.
        result: The result of `fit_parameters`.

    Raises:
        InputError: If it cannot be written there.
    """
    lines = [
        f"# Maximum marginal likelihood, {result.num_points} points of submaps "
        f"{', '.join(result.submap_ids)}:",
        f"# log likelihood per point {result.log_likelihood_before:.4f} before, "
        f"{result.log_likelihood_after:.4f} after.",
    ]
    fitted: dict[str, object] = {"noise_model": result.params.noise_model}
    for name in fitted_names(result.params):
        value = getattr(result.params, name)
        if value is not None:  # a missing line means None
            fitted[name] = float(f"{value:.6g}")
    text = "\n".join([*lines, tomli_w.dumps({"map": fitted})])
    with replacing(path) as unfinished:
        unfinished.write_text(text, encoding="utf-8")


def fitted_rows(results: Sequence[FitResult]) -> list[list[str]]:
    """Write the fits of single submaps as the rows of a table; the first one names the columns."""
    units = {name: bounds.unit for name, bounds in bounds_of(TerrainParams).items()}
    names = fitted_names(results[0].params)
    head = [f"{name} [{units[name]}]" if units[name] else name for name in names]
    rows = [["submap", *head, "log likelihood per point"]]
    for result in results:
        values = (f"{getattr(result.params, name):.4g}" for name in names)
        rows.append([*result.submap_ids, *values, f"{result.log_likelihood_after:.4f}"])
    return rows


def write_fitted_table(path: Path | str, results: Sequence[FitResult]) -> None:
    """Write fits of single submaps as CSV with a header; InputError if it cannot be written."""
    with replacing(path) as unfinished, unfinished.open("w", encoding="utf-8", newline="") as file:
        csv.writer(file).writerows(fitted_rows(results))
