"""``dataset.toml``: the description of a dataset."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import cast

import tomli_w

from gpgrad_core.errors import InputError
from gpgrad_core.reading.places import is_place
from gpgrad_core.reading.toml_files import read_toml

TEXT_KEYS = ("name", "description", "licence")
SENSOR_KEYS = ("constant", "quadratic")


@dataclass(frozen=True, eq=False)
class About:
    """The content of ``dataset.toml``; `Dataset` explains the fields."""

    name: str = ""
    description: str = ""
    licence: str = ""
    sensor_noise: dict[str, float] = field(default_factory=dict[str, float])
    preferred: dict[str, object] = field(default_factory=dict[str, object])
    notes: tuple[str, ...] = ()
    origin: tuple[float, float, float] | None = None


def read_about(path: Path, submap_ids: frozenset[str]) -> About:
    """Read ``dataset.toml``.

    Args:
        path: The file.
        submap_ids: Ids of the existing submaps, by which the preferred ones are checked.

    Raises:
        InputError: If the file is not TOML, a value has the wrong type, or a preferred submap does
            not exist.
    """
    table = read_toml(path)
    texts: dict[str, str] = {}
    for key in TEXT_KEYS:
        value = table.get(key, "")
        if not isinstance(value, str):
            raise InputError(f"{path}: {key} must be a text in quotes, got {value!r}")
        texts[key] = value
    known = {*TEXT_KEYS, "sensor_noise", "preferred", "origin"}
    return About(
        **texts,
        sensor_noise=_check_sensor_noise(table.get("sensor_noise", {}), path),
        preferred=_check_preferred(table.get("preferred", {}), path, submap_ids),
        notes=tuple(
            f"{path.name}: the unknown key {key!r} was ignored" for key in table if key not in known
        ),
        origin=_check_origin(table["origin"], path) if "origin" in table else None,
    )


def _check_origin(value: object, path: Path) -> tuple[float, float, float]:
    numbers = cast("list[object]", value) if isinstance(value, list) else []
    known = [float(n) for n in numbers if isinstance(n, int | float) and not isinstance(n, bool)]
    if len(known) != 3 or len(numbers) != 3 or not is_place(*known):
        raise InputError(
            f"{path}: origin must be [latitude, longitude, height] in degrees and metres, got "
            f"{value!r}"
        )
    return known[0], known[1], known[2]


def _check_sensor_noise(value: object, path: Path) -> dict[str, float]:
    if not isinstance(value, dict):
        raise InputError(f"{path}: sensor_noise must be a table, got {value!r}")
    noise: dict[str, float] = {}
    for key, number in cast("dict[str, object]", value).items():
        if key not in SENSOR_KEYS:
            raise InputError(
                f"{path}: sensor_noise has the keys {' and '.join(SENSOR_KEYS)}, got {key!r}"
            )
        if isinstance(number, bool) or not isinstance(number, int | float) or not 0 <= number < 1e6:
            raise InputError(
                f"{path}: sensor_noise.{key} must be a number, 0 or more, got {number!r}"
            )
        noise[key] = float(number)
    return noise


def _check_preferred(value: object, path: Path, submap_ids: frozenset[str]) -> dict[str, object]:
    if not isinstance(value, dict):
        raise InputError(f"{path}: preferred must be a table, got {value!r}")
    preferred = cast("dict[str, object]", value)
    for key, entry in preferred.items():
        if key in ("query", "database"):
            if not isinstance(entry, str):
                raise InputError(
                    f"{path}: preferred.{key} must be a submap's id in quotes, got {entry!r}"
                )
            if entry not in submap_ids:
                raise InputError(
                    f"{path}: preferred.{key} names submap {entry!r}, "
                    "which the dataset does not have"
                )
        elif not isinstance(entry, dict):
            # The pipeline checks the groups and names inside when it uses them.
            raise InputError(
                f"{path}: preferred.{key} must be a table of parameters, got {entry!r}"
            )
    pair = preferred.get("query"), preferred.get("database")
    if pair[0] is not None and pair[0] == pair[1] and len(submap_ids) > 1:
        raise InputError(
            f"{path}: preferred.query and preferred.database must be two different submaps, got "
            f"{pair[0]!r} twice"
        )
    return preferred


def write_about(path: Path, about: About) -> None:
    """Write ``dataset.toml``.

    Args:
        path: The file; it is overwritten if it exists.
        about: The content; its notes are not written.
    """
    parts = [tomli_w.dumps({key: getattr(about, key) for key in TEXT_KEYS if getattr(about, key)})]
    if about.sensor_noise:
        noise = tomli_w.dumps({"sensor_noise": about.sensor_noise})
        parts.append(f"# Noise of a point at range r [m]: constant + quadratic r^2\n{noise}")
    if about.origin is not None:
        place = tomli_w.dumps({"origin": list(about.origin)})
        # Before the tables: TOML would take it for a part of the last one.
        parts.insert(
            1,
            f"# Where the poses have their zero: latitude and longitude [deg], height [m]\n{place}",
        )
    if about.preferred:
        parts.append(tomli_w.dumps({"preferred": about.preferred}))
    path.write_text("\n".join(parts), encoding="utf-8", newline="\n")
