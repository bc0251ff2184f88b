"""``gpgrad simulate``: make a synthetic dataset."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro
from typing_extensions import Doc

from app.cli.flags import Given, Overwrite
from app.cli.terminal import conclude, progress_bar, working
from gpgrad_core.errors import count
from gpgrad_core.io.folder import check_vacant
from gpgrad_core.io.records.files import check_apart
from gpgrad_core.simulation.params import SimulationParams
from gpgrad_core.simulation.recording import simulate_recording
from gpgrad_core.simulation.simulate import simulate_into
from gpgrad_core.simulation.terrain import ElevationModel, params_on


@dataclass(frozen=True)
class Simulate:
    """Arguments of ``gpgrad simulate``."""

    directory: Annotated[
        tyro.conf.Positional[Path],
        Doc("Folder to make. It must not exist yet, or must be empty."),
        tyro.conf.arg(metavar="FOLDER"),
    ]
    scans: Annotated[
        int,
        Doc("Simulate a recording of this many scans, for gpgrad build. 0 simulates submaps."),
    ] = 0
    terrain: Annotated[
        Path | None,
        Doc(
            "GeoTIFF of an elevation model, in metres, whose middle the rover drives over. Only "
            "rocks are laid on it."
        ),
        tyro.conf.arg(metavar="FILE.tif", help_behavior_hint="(default: synthetic ground)"),
    ] = None
    terrain_scale: Annotated[
        float,
        Doc("How many metres a metre of the elevation model becomes, in all directions."),
    ] = 1.0
    terrain_exaggeration: Annotated[
        float, Doc("Factor of the elevation model's heights, after the scale.")
    ] = 1.0
    overwrite: Overwrite = False
    simulation: Annotated[Given[SimulationParams], tyro.conf.arg(name="")] = Given(SimulationParams)

    def run(self) -> None:
        check_vacant(self.directory, overwrite=self.overwrite)
        ground = str(self.simulation.values.get("ground", "varied"))
        params = self.simulation.over(params_on(ground))
        check_apart([self.directory], [self.terrain])
        terrain = None
        if self.terrain is not None:
            terrain = ElevationModel(self.terrain, self.terrain_scale, self.terrain_exaggeration)
        out, overwrite = self.directory, self.overwrite
        if self.scans:
            with progress_bar("simulate") as progress:
                simulate_recording(
                    out, self.scans, params, terrain=terrain, overwrite=overwrite, progress=progress
                )
            conclude(f"{count(self.scans, 'scan')}: {out}", output=out, scans=self.scans)
            return
        with working("simulate", params.num_submaps) as (progress, executor):
            simulate_into(
                out,
                params,
                terrain=terrain,
                overwrite=overwrite,
                executor=executor,
                progress=progress,
            )
        submaps = params.num_submaps
        conclude(f"{count(submaps, 'submap')}: {out}", output=out, submaps=submaps)
