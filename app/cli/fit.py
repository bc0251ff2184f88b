"""``gpgrad fit``: find the terrain's hyperparameters."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro
from typing_extensions import Doc

from app.cli.flags import Given
from app.cli.inputs import ParamsFile, base_params, load
from app.cli.terminal import conclude, progress_bar
from gpgrad_core.detection import fit_submap
from gpgrad_core.errors import count
from gpgrad_core.io.records.files import check_apart, check_output
from gpgrad_core.io.records.maps import fitted_rows, write_fitted, write_fitted_table
from gpgrad_core.mapping.fitting import FitResult, fit_parameters, fitted_names
from gpgrad_core.mapping.gradient_map import TerrainParams
from gpgrad_core.methods.paper import paper_params, paper_start
from gpgrad_core.params import SEEDS, bounds_of
from gpgrad_core.run import part
from gpgrad_core.types import Dataset

CHOSEN = ("noise_model", "noise_std")
"""Where the command line gives one of these, the noise model is not chosen."""


@dataclass(frozen=True)
class Fit:
    """Arguments of ``gpgrad fit``."""

    dataset: Annotated[
        tyro.conf.Positional[Path],
        Doc("Dataset folder, folder of clouds, or one cloud."),
        tyro.conf.arg(metavar="DATASET"),
    ]
    out: Annotated[
        Path | None,
        Doc(
            "Also write the parameters to this file, which the other verbs can read. The table of "
            "every submap goes to a file that ends in .csv."
        ),
        tyro.conf.arg(metavar="FILE.toml|FILE.csv"),
    ] = None
    each: Annotated[
        bool,
        Doc(
            "Fit every submap by itself, as the method paper does (its Sec. VI-B), and print "
            "a table. Then the start is the paper's where nothing is given."
        ),
    ] = False
    seed: Annotated[int, Doc("Seed of the random choice of points.")] = 0
    params: ParamsFile = None
    map: Annotated[
        Given[TerrainParams], Doc("The Gaussian process of the terrain, where the fit starts.")
    ] = Given(TerrainParams)

    def run(self) -> None:
        if self.out:
            check_output(self.out, (".csv",) if self.each else (".toml",))
            check_apart([self.out], [self.dataset, self.params])
        SEEDS.check("--seed", self.seed)
        dataset = load(self.dataset)
        if self.each:
            self._fit_each(dataset)
            return
        asked = base_params(dataset, self.params).map
        start = self.map.over(asked.guessed.terrain)
        choose = asked.chooses_noise and self.map.values.keys().isdisjoint(CHOSEN)
        with progress_bar("fit") as progress:
            result = fit_parameters(
                dataset.submaps, start, choose=choose, seed=self.seed, progress=progress
            )
        if self.out:
            write_fitted(self.out, result)
        conclude(
            *_fitted(start, result),
            *((str(self.out),) if self.out else ()),
            output=self.out,
            params={name: getattr(result.params, name) for name in fitted_names(result.params)},
            log_likelihood_before=float(result.log_likelihood_before),
            log_likelihood=float(result.log_likelihood_after),
        )

    def _fit_each(self, dataset: Dataset) -> None:
        asked, num = paper_params(base_params(dataset, self.params)).map, len(dataset.submaps)
        start, results = self.map.over(paper_start(asked)), list[FitResult]()
        with progress_bar("fit") as progress:
            for k, submap in enumerate(dataset.submaps):
                share = part(progress, k / num, (k + 1) / num)
                results.append(fit_submap(submap, start, seed=self.seed, progress=share))
        rows = fitted_rows(results)
        widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
        if self.out:
            write_fitted_table(self.out, results)
        conclude(
            *(
                "  ".join(cell.rjust(width) for cell, width in zip(row, widths, strict=True))
                for row in rows
            ),
            *((str(self.out),) if self.out else ()),
            output=self.out,
            columns=list(rows[0]),
            rows=[list(row) for row in rows[1:]],
        )


def _fitted(start: TerrainParams, result: FitResult) -> list[str]:
    units = {name: bounds.unit for name, bounds in bounds_of(TerrainParams).items()}
    lines: list[str] = []
    if result.params.noise_model != start.noise_model:
        lines.append(f"noise_model: {start.noise_model} -> {result.params.noise_model}")
    for name in fitted_names(result.params):
        before, after = (
            "the points' own" if value is None else f"{value:.4g}"
            for value in (getattr(start, name), getattr(result.params, name))
        )
        unit = f" {units[name]}" if units[name] else ""
        lines.append(f"{name}: {before} -> {after}{unit}")
    lines.append(
        f"log likelihood per point: {result.log_likelihood_before:.3f} -> "
        f"{result.log_likelihood_after:.3f} ({result.num_points:,} points of "
        f"{count(len(result.submap_ids), 'submap')}, {result.num_evaluations} evaluations)"
    )
    return lines
