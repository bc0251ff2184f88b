"""Fitted hyperparameters: a TOML file that ``--params`` reads, or a table of every submap's."""

import csv
from collections.abc import Sequence
from pathlib import Path

import tomli_w

from gpgrad_core.io.records.files import replacing
from gpgrad_core.mapping.fitting import FitResult, fitted_names
from gpgrad_core.mapping.gradient_map import TerrainParams
from gpgrad_core.params.fields import bounds_of


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
    """Write the fits of single submaps as the rows of a table; the first one names the columns.

    Args:
        results: One fit or more, with the same noise model.
    """
    units = {name: bounds.unit for name, bounds in bounds_of(TerrainParams).items()}
    names = fitted_names(results[0].params)
    head = [f"{name} [{units[name]}]" if units[name] else name for name in names]
    rows = [["submap", *head, "log likelihood per point"]]
    for result in results:
        values = (f"{getattr(result.params, name):.4g}" for name in names)
        rows.append([*result.submap_ids, *values, f"{result.log_likelihood_after:.4f}"])
    return rows


def write_fitted_table(path: Path | str, results: Sequence[FitResult]) -> None:
    """Write the fits of single submaps as comma-separated values with a header.

    Args:
        path: File to write.
        results: One fit or more, with the same noise model.

    Raises:
        InputError: If it cannot be written there.
    """
    with replacing(path) as unfinished, unfinished.open("w", encoding="utf-8", newline="") as file:
        csv.writer(file).writerows(fitted_rows(results))
