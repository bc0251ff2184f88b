"""What several verbs read: a dataset, a file of parameters, and the flags that they share."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, TypeAlias

import tyro
from typing_extensions import Doc

from app.cli.flags import Given, Overwrite
from app.cli.terminal import progress_bar, say, warn
from app.recordings import built_first
from gpgrad_core.detection import PipelineParams, describe_choice, is_resolved, resolve_parameters
from gpgrad_core.detection.shortlist import ALL_UP_TO, DEFAULT_CANDIDATES
from gpgrad_core.errors import InputError, count
from gpgrad_core.io.folder import load_dataset
from gpgrad_core.io.georeference import Georeference, make_georeference, read_origin
from gpgrad_core.params import preferred_parameters, read_parameters
from gpgrad_core.run import Progress, silent
from gpgrad_core.run.memo import Memo
from gpgrad_core.run.store import Store, default_folder
from gpgrad_core.types import Dataset, Submap

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
        f"automatic is all of up to {ALL_UP_TO} earlier submaps, and up to {DEFAULT_CANDIDATES} "
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
OriginFlag: TypeAlias = Annotated[
    str | None,
    Doc(
        "Where x = y = z = 0 is, with x to the east and y to the north: latitude, longitude "
        "[degrees] and height above the ellipsoid [m], or easting, northing and height [m]. After "
        "an equals sign it may begin with a minus."
    ),
    tyro.conf.arg(metavar="LAT,LON,HEIGHT", help_behavior_hint="(default: that of dataset.toml)"),
]
CrsFlag: TypeAlias = Annotated[
    str | None,
    Doc(
        "Coordinate system to write in: a projection in metres, such as EPSG:32633 or "
        "IAU_2015:49910. UTM takes the zone of the origin. Needs pip install 'gpgrad[geo]'."
    ),
    tyro.conf.arg(metavar="CODE", help_behavior_hint="(default: UTM if there is an origin)"),
]
AllParams: TypeAlias = Annotated[Given[PipelineParams], tyro.conf.arg(name="")]
ALL_PARAMS = Given(PipelineParams)


def load(
    path: Path,
    *,
    most_bytes: int | None = None,
    told: Progress = silent,
    on_submap: Callable[[Submap], None] | None = None,
) -> Dataset:
    """Load a dataset, and report what loading left out; see `load_dataset`."""
    with progress_bar("load") as progress, built_first(path):
        both = _both(progress, told)
        dataset = load_dataset(path, both, most_bytes=most_bytes, on_submap=on_submap)
    warn(*dataset.notes)
    return dataset


def base_params(dataset: Dataset, file: Path | None) -> PipelineParams:
    """What flags override: parameters of the file, over the dataset's, over built-in ones."""
    params = preferred_parameters(dataset, PipelineParams())
    return params if file is None else read_parameters(file, params)


@dataclass(frozen=True, kw_only=True)
class Comparing:
    """Flags of all verbs that compare submaps; their help lists them after their own."""

    overwrite: Overwrite = False
    cache: Cache = USERS_CACHE
    params: ParamsFile = None
    pipeline: AllParams = ALL_PARAMS

    def store(self) -> Store | None:
        return open_store(self.cache)

    def asked(self, dataset: Dataset, seed: int | None = None) -> PipelineParams:
        """The requested parameters: ``--seed`` and flags override `base_params`."""
        params = self.pipeline.over(base_params(dataset, self.params))
        if seed is None:
            return params
        return replace(params, registration=replace(params.registration, seed=seed))


def georeference_of(
    origin: str | None, crs: str | None, preferred: tuple[float, float, float] | None
) -> Georeference | None:
    """Place a local frame as the flags ask; None if they ask for nothing."""
    if origin is None and crs is None:
        return None
    place = preferred if origin is None else read_origin(origin)
    if place is None:
        raise InputError(
            f"--crs {crs}: the dataset does not say where it lies; give --origin LAT,LON,HEIGHT"
        )
    from gpgrad_core.io.records.georeferenced import check_libraries  # noqa: PLC0415 - loads slowly

    check_libraries()
    return make_georeference(place, None if crs is None or crs.upper() == "UTM" else crs)


def open_store(cache: str) -> Store | None:
    """Open the store that ``--cache`` names; None if nothing is to be stored, or can be."""
    if cache == NO_CACHE:
        return None
    folder = default_folder() if cache == USERS_CACHE else Path(cache)
    return None if folder is None else Store(folder)


def tell_damaged(store: Store | None) -> None:
    """Report the stored results that were damaged."""
    if store is not None and (damaged := store.take_damaged()):
        warn(f"{store.folder}: {count(damaged, 'kept result')} damaged, and made anew")


def resolved(
    params: PipelineParams,
    submaps: Sequence[Submap],
    name: str,
    memo: Memo,
    told: Progress = silent,
) -> PipelineParams:
    """Fit the parameters that are automatic, and report the result."""
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
