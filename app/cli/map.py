"""``gpgrad map``: infer the maps of one cloud."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro
from typing_extensions import Doc

from app.cli.flags import Given
from app.cli.inputs import (
    CrsFlag,
    OriginFlag,
    ParamsFile,
    base_params,
    georeference_of,
    load,
    resolved,
)
from app.cli.terminal import conclude, progress_bar, warn
from gpgrad_core.detection import infer_gradient_map
from gpgrad_core.errors import InputError
from gpgrad_core.io.records.files import check_apart, check_output
from gpgrad_core.io.records.georeferenced import write_cloud_optimised
from gpgrad_core.io.records.maps import MAP_ENDINGS, layers_of, write_map
from gpgrad_core.mapping.gradient_map import MapParams, map_grid
from gpgrad_core.run.memo import Memo


@dataclass(frozen=True)
class Map:
    """Arguments of ``gpgrad map``."""

    cloud: Annotated[
        tyro.conf.Positional[Path],
        Doc("Gravity-aligned point cloud."),
        tyro.conf.arg(metavar="CLOUD"),
    ]
    out: Annotated[
        Path,
        Doc(f"File to write. Its ending says how: {', '.join(MAP_ENDINGS)}."),
        tyro.conf.arg(metavar="FILE"),
    ]
    origin: OriginFlag = None
    crs: CrsFlag = None
    params: ParamsFile = None
    map: Annotated[Given[MapParams], Doc("The Gaussian process and the grid of the map.")] = Given(
        MapParams
    )

    def run(self) -> None:
        check_output(self.out, MAP_ENDINGS)
        if self.cloud.is_dir():
            raise InputError(f"{self.cloud}: is a folder; name one cloud")
        check_apart([self.out], [self.cloud, self.params])
        dataset = load(self.cloud)
        georeference = georeference_of(self.origin, self.crs, None)
        if georeference is not None and self.out.suffix.lower() not in (".tif", ".tiff"):
            raise InputError(
                f"{self.out}: only a GeoTIFF has coordinates; name a file that ends in .tif"
            )
        base = base_params(dataset, self.params)
        params = self.map.over(base.map)
        map_grid(dataset.submaps[0], params.resolution)  # refuses one that is too large at once
        (cloud,) = dataset.submaps
        corner = np.zeros(3)
        if georeference is not None:
            placed = georeference.apply(cloud.points)
            # Near zero while computing, because sums of large coordinates lose digits.
            corner[:2] = np.floor(placed[:, :2].mean(axis=0))
            cloud = replace(cloud, points=placed - corner)
        params = resolved(replace(base, map=params), [cloud], cloud.id, Memo()).map
        with progress_bar("map") as progress:
            gradient_map = infer_gradient_map(cloud, params, progress)
        if georeference is None:
            write_map(
                self.out,
                gradient_map,
                name=cloud.id,
                max_std_ratio=base.features.max_std_ratio,
            )
        else:
            x, y = gradient_map.grid.origin
            grid = replace(gradient_map.grid, origin=(x + corner[0], y + corner[1]))
            write_cloud_optimised(self.out, grid, layers_of(gradient_map), georeference)
        outlying = int(params.terrain.noise.of_points(cloud).outlying.sum())
        if outlying:
            warn(
                f"{outlying:,} of {len(cloud.points):,} points lie far off the ground around them "
                "and get a low weight"
            )
        rows, columns = gradient_map.grid.shape
        conclude(
            f"{columns} x {rows} cells of {params.resolution:g} m "
            f"from {len(cloud.points):,} points: {self.out}",
            output=self.out,
            rows=rows,
            columns=columns,
            resolution=params.resolution,
            points=len(cloud.points),
        )
