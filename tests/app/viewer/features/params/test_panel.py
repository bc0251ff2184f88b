from dataclasses import dataclass, field
from typing import Annotated, Literal

import pytest
import viser
from typing_extensions import Doc

from app.viewer.features.params.panel import ParamsPanel
from app.viewer.widgets.bridge import Bridge
from app.viewer.widgets.chips import Chips
from app.viewer.widgets.html import uuid_of
from app.viewer.widgets.numbers import Numbers
from gpgrad_core.detection import PipelineParams
from gpgrad_core.errors import InputError
from gpgrad_core.params import Bounds, check_bounds, parameters_of
from tests.support.widgets import find, html_says, labels, user_sets

MAIN = {"map.length_scale": "Length-scale", "closure.min_inliers": "Minimum inliers"}


@dataclass(frozen=True)
class Inner:
    kind: Annotated[Literal["a", "b"], Doc("Which.")] = "a"


@dataclass(frozen=True)
class Params:
    width: Annotated[float, Bounds(0.0, 10.0, 0.1, "m", slider=(1.0, 5.0)), Doc("How wide.")] = 2.0
    count: Annotated[int, Bounds(1, 100, 10, slider=(10, 100)), Doc("How many.")] = 11
    limit: Annotated[float | None, Bounds(0.0, 1.0, 0.01), Doc("At most.")] = None
    strict: Annotated[bool, Doc("Whether.")] = True
    reach: Annotated[float, Bounds(0.001, 10.0, 0.1, slider=(0.05, 2.0)), Doc("How far.")] = 0.3
    seed: Annotated[int, Doc("Random.")] = 0
    inner: Inner = field(default_factory=Inner)

    def __post_init__(self) -> None:
        check_bounds(self)


class Panel:
    """A panel of `Params` and what it reported."""

    def __init__(self, server: viser.ViserServer, value: Params) -> None:
        self.reported: list[Params] = []
        self.errors: list[str] = []
        self.panel = ParamsPanel(
            server,
            value,
            self.reported.append,
            main={"width": "Width"},
            on_error=self.errors.append,
        )


def test_every_parameter_of_the_pipeline_has_a_widget(server: viser.ViserServer) -> None:
    ParamsPanel(server, PipelineParams(), lambda value: None, main=MAIN)  # noqa: ARG005
    names = labels(server)
    for setting in parameters_of(PipelineParams):
        name = MAIN.get(setting.path, setting.path.rpartition(".")[2].replace("_", " "))
        assert any(label.startswith(name) for label in names), setting.path
    assert names[0] == "Length-scale [m]"
    assert "automatic length-scale" in names  # in the folder of all, for the slider above it


def test_units_docs_defaults_and_bounds_reach_the_widget(server: viser.ViserServer) -> None:
    ParamsPanel(server, Params(), lambda value: None, main={"width": "Width"})  # noqa: ARG005
    slider = find(server, "Width [m]")
    assert (slider.min, slider.max, slider.step) == (1.0, 5.0, 0.1)
    assert slider.hint.startswith("How wide. Default: 2 m")
    assert "Allowed: 0 to 10 m." in slider.hint  # as a refusal says


def test_a_user_reports_the_whole_new_value_on_its_step(server: viser.ViserServer) -> None:
    made = Panel(server, Params())
    user_sets(find(server, "Width"), 3.3000000000000003)
    user_sets(find(server, "kind"), "b")
    user_sets(find(server, "strict"), False)
    user_sets(find(server, "seed"), 5)
    assert made.reported[0] == Params(width=3.3)
    assert made.reported[-1] == Params(width=3.3, strict=False, seed=5, inner=Inner("b"))
    assert made.panel.value == made.reported[-1]


@pytest.mark.parametrize(
    ("label", "moved", "taken"),
    [
        ("count", 21, 20),  # a whole number stays one
        ("count", 1, 1),  # rounds to 0, which is not allowed
        ("reach", 0.06137, 0.0614),  # over decades it has three digits
    ],
)
def test_a_value_is_that_of_its_step(
    server: viser.ViserServer, label: str, moved: float, taken: float
) -> None:
    made = Panel(server, Params())
    assert find(server, "reach").step == pytest.approx(0.0001)
    user_sets(find(server, label), moved)
    reported = getattr(made.reported[-1], label)
    assert (reported, type(reported)) == (taken, type(taken))
    assert made.errors == []


def test_an_optional_parameter_can_be_automatic(server: viser.ViserServer) -> None:
    made = Panel(server, Params())
    box, slider = find(server, "automatic limit"), find(server, "limit")
    assert box.value
    assert slider.disabled
    user_sets(box, False)
    assert made.reported[-1].limit == slider.value
    assert not slider.disabled
    user_sets(slider, 0.7)
    assert made.reported[-1].limit == 0.7
    user_sets(box, True)
    assert made.reported[-1].limit is None


def test_chips_say_where_values_come_from_and_lead_back(server: viser.ViserServer) -> None:
    reported: list[Params] = []
    bridge = Bridge(server)
    chips = Chips(server, bridge)
    panel = ParamsPanel(server, Params(), reported.append, main={"width": "Width"}, chips=chips)
    names = {name: uuid_of(find(server, name)) for name in ("Width", "limit")}

    def words() -> list[str]:
        return [chips.shown[names[name]].word for name in ("Width", "limit")]

    assert words() == ["default", "auto"]
    user_sets(find(server, "Width"), 3.0)
    user_sets(find(server, "limit"), 0.7)
    assert words() == ["set ↺", "set ↺"]
    assert "the default, 2" in chips.shown[names["Width"]].hint
    html_says(bridge, "way-back", widget=names["limit"])
    assert words() == ["set ↺", "auto"]
    html_says(bridge, "way-back", widget=names["Width"])
    assert words() == ["default", "auto"]
    assert reported[-1] == Params()
    html_says(bridge, "way-back", widget=names["Width"])  # there is nothing to go back from
    html_says(bridge, "way-back", widget="another")
    assert len(reported) == 4
    reach = uuid_of(find(server, "reach"))
    assert chips.shown[reach].word == "default"
    panel.set(Params(), Params(reach=0.7))  # nobody asked for it: the points chose it
    assert chips.shown[reach].word == "auto"
    panel.set_default(Params(width=1.5))
    assert words() == ["set ↺", "auto"]


def test_setting_shows_without_reporting(server: viser.ViserServer) -> None:
    made = Panel(server, Params())
    made.panel.set(Params(width=4.0, limit=0.5, inner=Inner("b")))
    assert find(server, "Width").value == 4.0
    assert find(server, "limit").value == 0.5
    assert not find(server, "automatic limit").value
    assert find(server, "kind").value == "b"
    assert made.reported == []


def test_reset_goes_back_to_the_default(server: viser.ViserServer) -> None:
    made = Panel(server, Params(width=2.5))
    user_sets(find(server, "Width"), 4.0)
    assert made.panel.reset() == Params(width=2.5)
    assert find(server, "Width").value == 2.5
    made.panel.set_default(Params(width=1.5))
    assert made.panel.reset() == Params(width=1.5)


def test_a_value_beyond_the_slider_stretches_it(server: viser.ViserServer) -> None:
    made = Panel(server, Params(width=9.0))
    assert find(server, "Width").max == 9.0
    made.panel.set(Params(width=0.5))
    assert find(server, "Width").min == 0.5
    assert find(server, "Width").value == 0.5
    assert find(server, "Width").max == 5.0  # no longer needed


def test_a_value_typed_beyond_the_slider_does_not_stretch_it_for_good(
    server: viser.ViserServer,
) -> None:
    made = Panel(server, Params())
    slider = find(server, "Width")
    user_sets(slider, 7.3)
    assert made.reported[-1].width == 7.3
    assert (slider.min, slider.max) == (1.0, 7.3)  # the page keeps what was typed
    user_sets(slider, 4.0)
    assert (slider.min, slider.max) == (1.0, 7.3)  # it may be under a hand
    user_sets(find(server, "count"), 21)
    assert (slider.min, slider.max) == (1.0, 5.0)
    user_sets(slider, 0.5)
    made.panel.set(Params(width=3.0))
    assert (slider.min, slider.max) == (1.0, 5.0)


def test_a_typed_number_may_be_all_that_is_allowed(server: viser.ViserServer) -> None:
    bridge = Bridge(server)
    numbers = Numbers(server, bridge)
    answers: list[dict[str, object]] = []
    refused: list[str] = []
    moved: list[Params] = []
    reported: list[Params] = []
    bridge.call = lambda _, name, data: (  # type: ignore[method-assign]
        answers.append(data) if name != "heard" else None
    )
    numbers.refuse = refused.append
    panel = ParamsPanel(
        server,
        Params(),
        reported.append,
        main={"width": "Width"},
        on_move=moved.append,
        numbers=numbers,
    )
    slider = find(server, "Width")

    def types(text: str) -> None:
        html_says(bridge, "typed", widget=uuid_of(slider), text=text)

    types("7,3")
    assert (reported[-1].width, slider.value, slider.max) == (7.3, 7.3, 7.3)
    types("12")
    types("x")
    assert refused == [
        "Width must be from 0 to 10 m, got 12",
        "Width must be a number such as 0.8, got 'x'",
    ]
    types("7.30")
    assert [answer["changed"] for answer in answers] == [True, False, False, False]
    assert [bool(answer["refused"]) for answer in answers] == [False, True, True, False]
    user_sets(slider, 4.0)
    assert (moved, slider.value) == ([Params(width=4.0)], 4.0)
    assert panel.with_moved(Params(), uuid_of(slider), 3.04) == Params(width=3.0)
    assert panel.with_moved(Params(), "another", 3.0) == Params()


def test_a_refused_value_is_told_and_not_reported(server: viser.ViserServer) -> None:
    @dataclass(frozen=True)
    class Even:
        number: Annotated[int, Bounds(0, 10, 1), Doc("Even.")] = 2

        def __post_init__(self) -> None:
            if self.number % 2:
                raise InputError(f"number must be even, got {self.number}")

    reported: list[Even] = []
    errors: list[str] = []
    ParamsPanel(server, Even(), reported.append, main={"number": "Number"}, on_error=errors.append)
    user_sets(find(server, "Number"), 3)
    user_sets(find(server, "Number"), 4)
    assert errors == ["number must be even, got 3"]
    assert reported == [Even(4)]


def test_an_automatic_parameter_shows_the_number_in_use(server: viser.ViserServer) -> None:
    made = Panel(server, Params())
    box, slider = find(server, "automatic limit"), find(server, "limit")
    assert not slider.visible  # there is no number to show
    made.panel.set(Params(), Params(limit=0.123456))
    assert (box.value, slider.visible, slider.value) == (True, True, 0.123456)
    assert made.reported == []
    user_sets(box, False)  # it keeps the very number
    assert made.reported == [Params(limit=0.123456)]
    user_sets(box, True)
    assert made.reported[-1] == Params()
    assert slider.value == 0.123456  # until the fit tells another
    user_sets(slider, 0.5)
    assert made.reported[-1] == Params(limit=0.5)
    assert not box.value
    made.panel.set(Params(), Params(limit=0.25))
    assert (box.value, slider.value) == (True, 0.25)
