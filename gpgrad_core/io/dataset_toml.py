"""``dataset.toml``: what a dataset is, as its maker says."""

from pathlib import Path
from typing import Annotated, TypeAlias

import msgspec
import tomli_w
from msgspec import Meta, Struct, structs

from gpgrad_core.errors import InputError
from gpgrad_core.io.georeference import HIGHEST
from gpgrad_core.reading.records import as_record, read_toml
from gpgrad_core.types import Dataset, GroundChoice

NoiseTerm: TypeAlias = Annotated[float, Meta(ge=0.0, lt=1e6)]
GeoPosition: TypeAlias = tuple[
    Annotated[float, Meta(ge=-90.0, le=90.0)],
    Annotated[float, Meta(ge=-360.0, le=360.0)],
    Annotated[float, Meta(ge=-HIGHEST, le=HIGHEST)],
]
RULES = {
    "origin": "[latitude, longitude, height] in degrees and metres",
    "sensor_noise": "a table",
    "preferred": "a table",
    "ground": '"automatic", "filtered" or "all"',
}


class _SensorNoise(Struct, frozen=True, forbid_unknown_fields=True):
    constant: NoiseTerm | None = None
    quadratic: NoiseTerm | None = None


class _File(Struct):
    name: str = ""
    description: str = ""
    licence: str = ""
    sensor_noise: _SensorNoise = _SensorNoise()
    preferred: dict[str, object] = msgspec.field(default_factory=dict[str, object])
    origin: GeoPosition | None = None
    ground: GroundChoice = "automatic"


def read_dataset_toml(path: Path, submap_ids: frozenset[str]) -> Dataset:
    """Read ``dataset.toml`` as a dataset without submaps; ``notes`` names ignored keys."""
    table = read_toml(path)
    content = as_record(table, _File, str(path), RULES)
    _check_preferred(content.preferred, path, submap_ids)
    noise = structs.asdict(content.sensor_noise)
    return Dataset(
        content.name,
        (),
        description=content.description,
        licence=content.licence,
        sensor_noise={key: number for key, number in noise.items() if number is not None},
        preferred=content.preferred,
        notes=tuple(
            f"{path.name}: the unknown key {key!r} was ignored"
            for key in table
            if key not in _File.__struct_fields__
        ),
        origin=content.origin,
        ground=content.ground,
    )


def _check_preferred(preferred: dict[str, object], path: Path, submap_ids: frozenset[str]) -> None:
    for key, entry in preferred.items():
        if key not in ("query", "database"):
            # The pipeline checks the groups and names inside when it uses them.
            if not isinstance(entry, dict):
                raise InputError(
                    f"{path}: preferred.{key} must be a table of parameters, got {entry!r}"
                )
        elif not isinstance(entry, str):
            raise InputError(
                f"{path}: preferred.{key} must be a submap's id in quotes, got {entry!r}"
            )
        elif entry not in submap_ids:
            raise InputError(
                f"{path}: preferred.{key} names submap {entry!r}, which the dataset does not have"
            )
    query = preferred.get("query")
    if query is not None and query == preferred.get("database") and len(submap_ids) > 1:
        raise InputError(
            f"{path}: preferred.query and preferred.database must be two different submaps, got "
            f"{query!r} twice"
        )


def write_dataset_toml(path: Path, dataset: Dataset) -> None:
    """Write ``dataset.toml``, all but the submaps and notes."""
    texts = {key: getattr(dataset, key) for key in ("name", "description", "licence")}
    parts = [tomli_w.dumps({key: text for key, text in texts.items() if text})]
    if dataset.ground != "automatic":
        parts.append(tomli_w.dumps({"ground": dataset.ground}))
    if dataset.origin is not None:  # before the tables: TOML would take it for a part of the last
        place = tomli_w.dumps({"origin": list(dataset.origin)})
        head = "# Where the poses have their zero: latitude and longitude [deg], height [m]"
        parts.append(f"{head}\n{place}")
    if dataset.sensor_noise:
        noise = tomli_w.dumps({"sensor_noise": dataset.sensor_noise})
        parts.append(f"# Noise of a point at range r [m]: constant + quadratic r^2\n{noise}")
    if dataset.preferred:
        parts.append(tomli_w.dumps({"preferred": dataset.preferred}))
    path.write_text("\n".join(parts), encoding="utf-8", newline="\n")
