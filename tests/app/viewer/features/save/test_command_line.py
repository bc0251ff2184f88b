"""Whatever is set, the command line reads it back as the same."""

import shlex
from dataclasses import replace
from typing import Any

from app.cli.detect import Detect
from app.cli.flags import parse
from app.viewer.session.session_file import detect_command
from app.viewer.session.state import open_dataset, with_pair, with_params
from gpgrad_core.detection import PipelineParams
from gpgrad_core.params import (
    Field,
    changes,
    flag_of,
    get_path,
    parameters_of,
    preferred_parameters,
    with_path,
)
from tests.support.synthetic import make_dataset

SETTINGS = parameters_of(PipelineParams)


def another(setting: Field) -> Any:
    """Give a value that is not the default."""
    default: Any = get_path(PipelineParams(), setting.path)
    if isinstance(setting.kind, tuple):
        return next(choice for choice in setting.kind if choice != default)
    if setting.kind is bool:
        return not default
    if setting.bounds is None or setting.kind is int:
        return 23
    return 0.1 + 0.2  # a number whose shortest text is long


def flags(params: PipelineParams, base: PipelineParams) -> list[str]:
    """List the flags that turn a base into params."""
    return [
        word for setting, value in changes(params, base) for word in flag_of(setting.path, value)
    ]


def test_every_parameter_is_read_back_and_taken_back() -> None:
    base = params = PipelineParams()
    for setting in SETTINGS:
        alone = with_path(base, setting.path, another(setting))
        assert 1 <= len(flags(alone, base)) <= 2
        assert 1 <= len(flags(base, alone)) <= 2
        params = with_path(params, setting.path, another(setting))
    for asked, start in ((params, base), (base, params)):  # all in one line: to read one takes long
        words = flags(asked, start)
        verb = parse(Detect, "detect", ["data", "--out", "closures.json", *words], "")
        assert verb.pipeline.over(start) == asked


def test_only_what_differs_from_the_datasets_own_is_named_and_all_is_quoted() -> None:
    dataset = replace(make_dataset(), preferred={"map": {"length_scale": 0.45}})
    params = preferred_parameters(dataset, PipelineParams())
    state = open_dataset(dataset, params, source="/data/my rover's; rm -rf")
    state = with_pair(state, query_id="002", database_id="001")
    words = shlex.split(detect_command(state))
    assert words[:3] == ["gpgrad", "detect", "/data/my rover's; rm -rf"]
    assert words[3:] == ["--out", "closures.json", "--pair", "002", "001"]
    changed = with_params(state, with_path(params, "map.length_scale", 0.3))
    assert shlex.split(detect_command(changed))[8:] == ["--map.length-scale", "0.3"]
