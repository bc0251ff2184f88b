from dataclasses import replace
from pathlib import Path
from typing import get_args

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from app.viewer.session.layers import LAYERS, ColorMap
from app.viewer.session.session_file import (
    LONGEST,
    Keyframe,
    address_of,
    parse_session,
    read_address,
    read_session,
    session_text,
)
from app.viewer.session.state import (
    Camera,
    Layout,
    Setting,
    ViewOptions,
    ViewState,
    open_dataset,
    with_pair,
)
from gpgrad_core.detection import PipelineParams
from gpgrad_core.errors import InputError
from gpgrad_core.mapping.gradient_map import MapParams
from gpgrad_core.simulation.demo import demo_path
from tests.support.refusal import assert_refused
from tests.support.synthetic import make_dataset

DATASET = make_dataset(num_points=50)
finite = st.floats(-1e6, 1e6)


def state_of(params: PipelineParams, options: ViewOptions) -> ViewState:
    state = open_dataset(DATASET, params, options, "/data/Mt. \"Ætna\" 'x'\\y")
    return with_pair(state, query_id="002", database_id="001")


@settings(max_examples=25)
@given(
    length_scale=st.floats(0.01, 100.0),
    max_points=st.none() | st.integers(3, 10_000_000),
    layer=st.sampled_from(tuple(LAYERS)),
    layout=st.sampled_from(get_args(Layout)),
    color_map=st.sampled_from(get_args(ColorMap)),
    switch=st.booleans(),
    point_size=st.floats(0.005, 0.2),
    camera=st.none() | st.builds(Camera, st.tuples(finite, finite, finite), st.just((0.0, 1, 2))),
)
def test_all_goes_there_and_back(
    length_scale: float,
    max_points: int | None,
    layer: str,
    layout: str,
    color_map: str,
    switch: bool,
    point_size: float,
    camera: Camera | None,
) -> None:
    options = ViewOptions(
        layer=layer,  # type: ignore[arg-type]
        layout=layout,  # type: ignore[arg-type]
        color_map=color_map,  # type: ignore[arg-type]
        surfaces=switch,
        point_size=point_size,
    )
    params = PipelineParams(map=MapParams(length_scale=length_scale, max_points=max_points))
    reference = Setting("paper", replace(params, map=MapParams())) if switch else None
    state = replace(state_of(params, options), reference=reference)
    file = parse_session(session_text(state, camera), "here")
    assert file.camera == camera
    for saved in (file, read_address(address_of(state))):
        assert saved.dataset == Path(state.source)
        saved.check(DATASET)
        restored = saved.apply(open_dataset(DATASET, PipelineParams(), source=state.source))
        restored = replace(restored, others=state.others)  # of the method that runs only
        assert replace(restored, dataset=state.dataset).__dict__ == state.__dict__


def test_keyframes_are_saved_and_restored() -> None:
    camera = Camera((1.0, 2.0, 3.0), (0.0, 0.0, 0.0))
    frames = (
        Keyframe("Here", "it is 'seen'", ViewOptions(layer="std", beyond_noise=True), camera),
        Keyframe("", subject="world"),
    )
    state = state_of(PipelineParams(), ViewOptions())
    text = session_text(state, None, keyframes=frames)
    assert parse_session(text, "here").keyframes == frames
    assert parse_session(session_text(state, None), "here").keyframes == ()
    for table, said in (
        ("title = 3", "title"),
        ("title = 'a'\nview = { layer = 'air' }", r"keyframes\[0\], view: layer"),
        ("title = 'a'\ncamera = { position = [1, 2] }", "camera"),
    ):
        with pytest.raises(InputError, match=said):
            parse_session(f"[[keyframes]]\n{table}", "here")


def test_a_pair_of_one_submap_twice_is_refused() -> None:
    twice = parse_session("query = '001'\ndatabase = '001'", "here")
    with pytest.raises(InputError, match="001 beside itself is no pair"):
        twice.check(DATASET)
    lone = replace(DATASET, submaps=DATASET.submaps[1:2])
    twice.check(lone)  # as older viewers saved it
    state = twice.apply(open_dataset(lone, PipelineParams(), source="/data/one"))
    for again in (
        parse_session(session_text(state, None), "here"),
        read_address(address_of(state)),
    ):
        assert (again.query_id, again.database_id) == ("001", None)
    with pytest.raises(InputError, match="another submap than the query"):
        parse_session("[[decisions]]\nquery = '1'\ndatabase = '1'\naccepted = true", "here")


def test_the_demo_is_no_path_of_this_machine() -> None:
    state = open_dataset(DATASET, PARAMS, source=str(demo_path()))
    text = session_text(state, None)
    assert str(demo_path()) not in text
    # What is as gpgrad has it is not named in an address.
    assert address_of(state) == f"query={state.query_id}&database={state.database_id}"
    for saved in (parse_session(text, "here"), read_address(address_of(state))):
        assert (saved.dataset, saved.camera) == (None, None)
        assert (saved.params, saved.options) == (PARAMS, ViewOptions())


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("dataset = 3", "here: 'dataset' must be a text, got 3"),
        ("[map]\nlength_scale = 0.3", "here: has the unknown key 'map'"),
        ("[params.map]\nlenght_scale = 0.3", "did you mean map.length_scale?"),
        ("[view]\nlayer = 'depth'", "here, [view]: layer must be"),
        ("[view]\npoint_size = 7", "point_size must be from 0.005 to 0.2 m"),
        ("view = 3", "here: 'view' must be a table, [view]"),
        ("[camera]\nposition = [1, 2]\nlook_at = [0, 0, 0]", "must be three numbers"),
        ("[camera]\nposition = [1, 2, nan]\nlook_at = [0, 0, 0]", "must be three numbers"),
        ("what is this", "here: is not TOML"),
        ("a." * 49_000 + "a = 1", "more than 20 parts"),
        ("x = " + "[" * 5000, "nested more than 20 deep"),
        ("#" * 200_000, "larger than 100,000 bytes"),
        ('dataset = "a\\u0000b"', "zero byte"),
        (f'dataset = "{"a" * 5000}"', "too long"),
        ("[camera]\nposition = [true, 1, 2]\nlook_at = [0, 0, 0]", "camera: 'position'"),
        ("[camera]\nposition = [1e30, 1, 2]\nlook_at = [0, 0, 0]", "camera: 'position'"),
    ],
)
def test_what_cannot_be_is_refused_in_one_line(text: str, said: str) -> None:
    assert_refused(lambda: parse_session(text, "here"), "here", said)


def test_a_file_that_cannot_be_read_and_a_pair_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="cannot be read"):
        read_session(tmp_path / "nowhere.toml")
    (tmp_path / "odd.toml").write_bytes(b"\xff\xff")
    with pytest.raises(InputError, match="UTF-8"):
        read_session(tmp_path / "odd.toml")
    with pytest.raises(InputError, match="no submap '999'"):
        parse_session("query = '999'", "here").check(DATASET)


# Addresses.

PARAMS = PipelineParams()
STATE = open_dataset(DATASET, PARAMS, source="/data/mars yard #1 & more")
CAMERA = Camera((1.5, -20.25, 1000.0), (0.0, 0.001, -3.0))


def test_an_address_says_scene_and_camera() -> None:
    text = address_of(STATE, "world", CAMERA)
    link = read_address(text)
    assert (link.subject, link.camera) == ("world", CAMERA)
    assert not {" ", "#"} & set(text)


@pytest.mark.parametrize(("text", "shown"), [("0", False), ("1", True), ("true", True)])
def test_a_truth_value_is_a_word_or_a_digit(text: str, shown: bool) -> None:
    assert read_address(f"query=1&view.surfaces={text}").options.surfaces is shown


def test_a_dark_page_stays_the_readers_own() -> None:
    state = replace(STATE, options=replace(ViewOptions(), dark=True))
    assert "dark" not in address_of(state)
    assert read_address("query=1", replace(ViewOptions(), dark=True)).options.dark
    with pytest.raises(InputError, match="true or false"):
        read_address("view.dark=yes")


def test_what_has_no_path_has_no_address() -> None:
    assert address_of(replace(STATE, source="")) == ""
    assert address_of(replace(STATE, source="/" + "x" * LONGEST)) == ""


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("x" * (LONGEST + 1), "characters"),
        ("nonsense", "name=value"),
        ("&".join(f"a{k}=1" for k in range(500)), "name=value"),
        ("query=1&query=2", "twice"),
        ("token=secret", "unknown word 'token'"),
        ("params.map.lenght_scale=1", "unknown parameter"),
        ("params.map=1", "unknown parameter"),
        ("params.map.length_scale=-1", "length_scale"),
        ("params.map.length_scale=nan", "must be a number"),
        ("params.map.length_scale=inf", "must be a number"),
        ("params.map.length_scale=" + "9" * 5000, "characters"),
        ("params.map.length_scale=" + "9" * 99, "length_scale must be from"),
        ("params.registration.trials=1.5", "must be a whole number"),
        ("view.layer=<script>", "layer"),
        ("view.swipe=7", "swipe"),
        ("scene=moon", "pair or world"),
        ("dataset=a%00b", "dataset"),
        ("camera=1,2,3", "six numbers"),
        ("camera=1,2,3,4,5,x", "six numbers"),
        ("camera=1,2,3,1,2,3", "cannot be at"),
        ("camera=1e300,2,3,1,2,3", "six numbers that are places"),
    ],
)
def test_an_address_that_cannot_be_is_refused_in_one_line(text: str, said: str) -> None:
    assert_refused(lambda: read_address(text), "the link", said)


def test_a_rounding_error_of_the_camera_is_not_in_the_address() -> None:
    camera = Camera((-1.3e-15, -23.341, 33.12), (0.0, -1.1e-16, -1.07))
    assert address_of(STATE, camera=camera).endswith("camera=0,-23.34,33.12,0,0,-1.07")
