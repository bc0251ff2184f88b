from dataclasses import replace

import pytest

from app.viewer.features.links.address import LONGEST, address_of, read_address
from app.viewer.session.state import Camera, ViewOptions, open_dataset, with_params
from gpgrad_core.detection import PipelineParams
from gpgrad_core.errors import InputError
from gpgrad_core.params import with_path
from gpgrad_core.simulation.demo import demo_path
from tests.support.synthetic import make_dataset

PARAMS = PipelineParams()
STATE = open_dataset(make_dataset(num_points=100), PARAMS, source="/data/mars yard #1 & more")
CAMERA = Camera((1.5, -20.25, 1000.0), (0.0, 0.001, -3.0))


def test_what_an_address_says_is_read_again() -> None:
    params = with_path(PARAMS, "map.length_scale", 0.30000000000000004)
    params = with_path(params, "matching.mutual", value=not PARAMS.matching.mutual)
    options = replace(ViewOptions(), layer="gradient", layout="registered", all_lines=True)
    state = replace(with_params(STATE, params), options=options)
    text = address_of(state, "world", CAMERA)
    link = read_address(text)
    assert link.subject == "world"
    assert str(link.saved.dataset) == STATE.source
    assert (link.saved.query_id, link.saved.database_id) == (STATE.query_id, STATE.database_id)
    assert link.saved.params == params
    assert link.saved.options == options
    assert link.saved.camera == CAMERA
    assert " " not in text
    assert "#" not in text


def test_what_is_as_gpgrad_has_it_is_not_named() -> None:
    state = replace(STATE, source=str(demo_path()))
    assert address_of(state) == f"query={STATE.query_id}&database={STATE.database_id}"
    link = read_address(address_of(state))
    assert link.saved.dataset is None
    assert (link.saved.params, link.saved.options) == (PARAMS, ViewOptions())
    assert link.saved.camera is None


def test_a_dark_page_stays_the_readers_own() -> None:
    state = replace(STATE, options=replace(ViewOptions(), dark=True))
    assert "dark" not in address_of(state)
    assert read_address("query=1", replace(ViewOptions(), dark=True)).saved.options.dark
    with pytest.raises(InputError, match="true or false"):
        read_address("view.dark=yes")


def test_one_submap_alone_has_a_link_without_a_pair() -> None:
    lone = replace(STATE.dataset, submaps=STATE.dataset.submaps[:1])
    state = replace(STATE, dataset=lone, query_id="000", database_id="000")
    link = read_address(address_of(state))
    assert (link.saved.query_id, link.saved.database_id) == ("000", None)


def test_what_has_no_path_has_no_address() -> None:
    assert address_of(replace(STATE, source="")) == ""
    assert address_of(replace(STATE, source="/" + "x" * LONGEST)) == ""


@pytest.mark.parametrize(
    ("text", "says"),
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
def test_what_cannot_be_is_refused_in_one_line(text: str, says: str) -> None:
    with pytest.raises(InputError, match=says) as caught:
        read_address(text)
    assert "\n" not in str(caught.value)
    assert str(caught.value).startswith("the link")


def test_a_rounding_error_of_the_camera_is_not_in_the_address() -> None:
    camera = Camera((-1.3e-15, -23.341, 33.12), (0.0, -1.1e-16, -1.07))
    assert address_of(STATE, camera=camera).endswith("camera=0,-23.34,33.12,0,0,-1.07")
