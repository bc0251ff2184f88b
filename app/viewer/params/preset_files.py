"""Presets: sets of parameters with a name and what they are good for."""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import tomli_w

from app.viewer.methods import MethodName
from gpgrad_core.errors import InputError
from gpgrad_core.methods.paper import paper_params
from gpgrad_core.outputs import replacing
from gpgrad_core.params.files import read_parameters, to_tables, with_tables
from gpgrad_core.pipeline import PipelineParams

NAME = re.compile(r"[^\W_][\w .()+-]{0,59}")
"""What a preset may be called, so that it can be a file's name on every system."""

MOST = 200
"""Presets of one's own; any page may save some, and each session reads all of them."""


@dataclass(frozen=True)
class Preset:
    """Parameters worth coming back to.

    Attributes:
        name: Its name.
        purpose: What it is good for, in one line.
        params: The parameters.
        method: Whose parameters they are; None is any method's, as a file does not say.
    """

    name: str
    purpose: str
    params: PipelineParams
    method: MethodName | None = "gradient"

    def is_set(self, method: MethodName, params: PipelineParams) -> bool:
        """Say whether a method runs with these parameters."""
        return params == self.params and self.method in (None, method)


def _with(**groups: Mapping[str, object]) -> PipelineParams:
    return with_tables(PipelineParams(), groups, "preset")


BUILT_IN: tuple[Preset, ...] = (
    Preset(
        "default",
        "For stereo clouds of a rover with a point every few centimetres. It finds nearly all "
        "true closures, and no false one, on a Mars yard, a volcano and the Moon.",
        PipelineParams(),
    ),
    Preset(
        "paper",
        "The method of Le Gentil et al. 2020 with its own numbers: a tuning of every submap, 5,000 "
        "points, SURF, Algorithm 1 and five inliers.",
        paper_params(PipelineParams()),
        "paper",
    ),
    Preset(
        "rough ground",
        "For rocks and ripples of a few decimetres in dense clouds. A shorter length-scale keeps "
        "them, and the neighbours of each point measure its noise.",
        _with(map={"length_scale": 0.2, "noise_model": "measured"}),
    ),
    Preset(
        "smooth ground",
        "For swells of half a metre and more in noisy clouds. A longer length-scale averages over "
        "more points, and the neighbours of each point measure its noise.",
        _with(map={"length_scale": 0.45, "noise_model": "measured"}),
    ),
)


def own_presets(folder: Path) -> tuple[tuple[Preset, ...], tuple[str, ...]]:
    """Read the presets that the user has saved.

    Args:
        folder: Where they lie, a TOML file each; it need not exist.

    Returns:
        The presets by name, and a line for each file that cannot be read.
    """
    found: list[Preset] = []
    notes: list[str] = []
    for path in sorted(folder.glob("*.toml")):
        if not NAME.fullmatch(path.stem):
            notes.append(f"{path.name}: cannot be the name of a preset")
            continue
        try:
            params = read_parameters(path, PipelineParams())
        except (InputError, OSError) as error:
            notes.append(str(error))
            continue
        found.append(_own(path, params))
    return tuple(found), tuple(notes)


def save_preset(folder: Path, name: str, params: PipelineParams) -> Preset:
    """Save parameters as one of the user's presets; one of the same name is replaced.

    Args:
        folder: Where they lie; made if need be.
        name: Of letters, digits, spaces and a few marks.
        params: What to save, all of it.

    Returns:
        The preset; its purpose names the file, which ``--params`` reads.

    Raises:
        InputError: If the name cannot be used, there are too many presets already, or the file
            cannot be written.
    """
    path = _path(folder, name)
    if len([other for other in folder.glob("*.toml") if other != path]) >= MOST:
        raise InputError(f"There are {MOST} presets, which is the most: delete one first")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with replacing(path) as unfinished:
            unfinished.write_text(preset_text(name, params), encoding="utf-8")
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror or error}") from error
    return _own(path, params)


def delete_preset(folder: Path, name: str) -> None:
    """Delete one of the user's presets.

    Raises:
        InputError: If there is none of that name.
    """
    try:
        _path(folder, name).unlink()
    except OSError as error:
        raise InputError(f"{name}: is not one of your own presets") from error


def preset_text(name: str, params: PipelineParams) -> str:
    """Write the TOML of a preset."""
    return f"# gpgrad parameters: {name}\n{tomli_w.dumps(to_tables(params))}"


def _own(path: Path, params: PipelineParams) -> Preset:
    return Preset(path.stem, f"Your own: {path}", params, None)


def _path(folder: Path, name: str) -> Path:
    name = name.strip()
    if not NAME.fullmatch(name) or name.endswith("."):
        raise InputError(
            f"{name!r} cannot be a preset's name: use up to 60 letters, digits, spaces and . + - ()"
        )
    if any(name == preset.name for preset in BUILT_IN):
        raise InputError(f"{name!r} is a built-in preset: choose another name")
    return folder / f"{name}.toml"
