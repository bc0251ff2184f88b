"""Fitted hyperparameters as a TOML file that ``--params`` reads."""

from pathlib import Path

import tomli_w

from gpgrad_core.fitting import FitResult, fitted_names
from gpgrad_core.outputs.files import replacing


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
