"""What most verbs read: a dataset, a file of parameters, and the flags that they share."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, TypeAlias

import tyro
from typing_extensions import Doc

from app.cli.flags import Given
from app.cli.terminal import count, progress_bar, say, warn
from app.recordings import built_first
from gpgrad_core.detection import PipelineParams, describe_choice, is_resolved, resolve_parameters
from gpgrad_core.detection.shortlist import ALL_UP_TO, DEFAULT_CANDIDATES
from gpgrad_core.io.folder import MOST_LOADED, Outline, load_dataset, open_dataset
from gpgrad_core.params.files import preferred_parameters, read_parameters
from gpgrad_core.run.memo import Memo
from gpgrad_core.run.progress import Progress, silent
from gpgrad_core.run.store import Store
from gpgrad_core.types import Dataset, Submap, SubmapSource

DatasetPath: TypeAlias = Annotated[
    tyro.conf.Positional[Path],
    Doc("Dataset folder or folder of clouds."),
    tyro.conf.arg(metavar="DATASET"),
]
ParamsFile: TypeAlias = Annotated[
    Path | None,
    Doc(
        "TOML file of parameters, with one table for each group: [map] length_scale = 0.3. Flags "
        "override it."
    ),
    tyro.conf.arg(metavar="FILE.toml"),
]
CandidatesFlag: TypeAlias = Annotated[
    str,
    Doc(
        "With how many earlier submaps each submap is compared: a number, all, or automatic. "
        f"automatic is all of up to {ALL_UP_TO} earlier submaps, and the {DEFAULT_CANDIDATES} most "
        "promising ones of more."
    ),
    tyro.conf.arg(metavar="K|all|automatic"),
]
USERS_CACHE, NO_CACHE = "user", "none"
Cache: TypeAlias = Annotated[
    str,
    Doc(
        "Folder in which results are kept, so that a later run need not compute them again. none "
        "keeps nothing."
    ),
    tyro.conf.arg(metavar="DIR|none", help_behavior_hint="(default: in the user's cache folder)"),
]
SeedFlag: TypeAlias = Annotated[
    int | None,
    Doc("Seed of all random choices."),
    tyro.conf.arg(help_behavior_hint="(default: the registration's seed)"),
]
AllParams: TypeAlias = Annotated[Given[PipelineParams], tyro.conf.arg(name="")]
ALL_PARAMS = Given(PipelineParams)


def load(path: Path, *, most_bytes: int | None = None, told: Progress = silent) -> Dataset:
    """Load a dataset, and report what loading left out.

    Args:
        path: The dataset.
        most_bytes: Bytes of points to keep in memory; further ones wait in a temporary file. None
            keeps all in memory.
        told: Given the fraction done, beside the bar on the terminal; may raise Cancelled.
    """
    with progress_bar("load") as progress, built_first(path):
        dataset = load_dataset(path, _both(progress, told), most_bytes=most_bytes)
    for note in dataset.notes:
        warn(note)
    return dataset


def load_sources(
    outline: Outline,
    check: Callable[[Submap], None] | None = None,
    *,
    most_bytes: int = MOST_LOADED,
) -> tuple[Dataset, tuple[SubmapSource, ...]]:
    """Read a dataset of any size, and report what reading left out.

    Args:
        outline: The dataset.
        check: Called with each submap; may raise an error.
        most_bytes: Bytes of points to keep in memory.

    Returns:
        The dataset, whose submaps lack their points, and where they are loaded from.
    """
    with progress_bar("load") as progress:
        dataset, sources = open_dataset(outline, progress, check=check, most_bytes=most_bytes)
    for note in dataset.notes:
        warn(note)
    return dataset, sources


def base_params(dataset: Dataset, file: Path | None) -> PipelineParams:
    """Give the parameters that flags override: the file's, over the dataset's, over built-in ones.

    Args:
        dataset: May prefer parameters.
        file: TOML file of parameters, if there is one.
    """
    params = preferred_parameters(dataset, PipelineParams())
    return params if file is None else read_parameters(file, params)


def asked_params(
    dataset: Dataset, file: Path | None, flags: Given[PipelineParams], seed: int | None = None
) -> PipelineParams:
    """Give the parameters that are asked for: ``--seed`` and flags override `base_params`."""
    params = flags.over(base_params(dataset, file))
    if seed is None:
        return params
    return replace(params, registration=replace(params.registration, seed=seed))


def open_store(cache: str) -> Store | None:
    """Open the store that ``--cache`` names; None if nothing is to be kept.

    Raises:
        InputError: If there is a file of that name.
    """
    if cache == NO_CACHE:
        return None
    return Store() if cache == USERS_CACHE else Store(Path(cache))


def tell_damaged(store: Store | None) -> None:
    """Report the kept results that were damaged."""
    if store is not None and (damaged := store.take_damaged()):
        warn(f"{store.folder}: {count(damaged, 'kept result')} damaged, and made anew")


def settled(
    params: PipelineParams,
    submaps: Sequence[Submap],
    name: str,
    memo: Memo,
    told: Progress = silent,
) -> PipelineParams:
    """Fit the parameters that are automatic, and report what was found.

    Args:
        params: May be automatic in part.
        submaps: They are fitted to these.
        name: Of the dataset.
        memo: Keeps the fit; with a store also for later runs.
        told: Given the fraction done, beside the bar on the terminal; may raise Cancelled.
    """
    if is_resolved(params) or not submaps:
        return params
    with progress_bar("fit") as progress:
        fitted = resolve_parameters(submaps, params, memo, _both(progress, told))
    say(f"{name}: {describe_choice(params, fitted)}")
    return fitted


def _both(first: Progress, second: Progress) -> Progress:
    def progress(fraction: float) -> None:
        first(fraction)
        second(fraction)

    return progress
