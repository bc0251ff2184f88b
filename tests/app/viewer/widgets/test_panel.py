from dataclasses import dataclass, field
from typing import Annotated, Literal

import pytest
import viser
from typing_extensions import Doc

from app.viewer.session.state import Widget
from app.viewer.widgets.bridge import Bridge
from app.viewer.widgets.html import uuid_of
from app.viewer.widgets.numbers import Numbers
from app.viewer.widgets.panel import Panel
from gpgrad_core.detection import PipelineParams
from gpgrad_core.errors import InputError
from gpgrad_core.params import Bounds, check_bounds, parameters_of
from tests.support.widgets import find, html_says, labels, user_sets

MAIN = {"map.length_scale": "Length-scale", "closure.min_inliers": "Minimum inliers"}
WIDGETS = {"limit": Widget(automatic="no limit"), "inner.kind": Widget("Kind")}


@dataclass(frozen=True)
class Inner:
    kind: Annotated[Literal["a", "b"], Doc("Which.")] = "a"
    depth: Annotated[float, Bounds(0.0, 5.0, 0.1, "m"), Doc("How deep.")] = 1.0


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


class Made:
    """A panel of `Params`, what it reported, and what its number boxes were told."""

    def __init__(self, server: viser.ViserServer, value: Params) -> None:
        self.reported: list[Params] = []
        self.moved: list[Params] = []
        self.errors: list[str] = []
        self.bridge = Bridge(server)
        self.numbers = Numbers(server, self.bridge)
        self.panel = Panel(
            server,
            value,
            self.reported.append,
            widgets=WIDGETS,
            numbers=self.numbers,
            default=value,
            on_move=self._move,
            on_error=self.errors.append,
        )

    def _move(self, params: Params) -> None:
        self.moved.append(params)
        self.reported.append(params)


def test_every_parameter_of_the_pipeline_has_a_widget(server: viser.ViserServer) -> None:
    widgets = {path: Widget(name) for path, name in MAIN.items()}
    params = PipelineParams()
    Panel(server, params, lambda _: None, widgets=widgets, default=params)
    names = labels(server)
    for setting in parameters_of(PipelineParams):
        name = setting.path.rpartition(".")[2].replace("_", " ").capitalize()
        name = MAIN.get(setting.path, name)
        assert any(label.startswith(name) for label in names), setting.path
    assert names[0] == "Length-scale [m]"
    assert "Auto length-scale" in names  # in the folder of all, for the slider above it


def test_a_user_reports_the_whole_new_value_on_its_step(server: viser.ViserServer) -> None:
    made = Made(server, Params())
    slider = find(server, "Width [m]")
    assert (slider.min, slider.max, slider.step) == (1.0, 5.0, 0.1)
    assert slider.hint.startswith("How wide. Default: 2 m")
    assert "Allowed: 0 to 10 m." in slider.hint  # as a refusal says
    user_sets(slider, 3.3000000000000003)
    user_sets(find(server, "Kind"), "b")
    user_sets(find(server, "Strict"), False)
    user_sets(find(server, "Seed"), 5)
    assert made.reported[0] == Params(width=3.3)
    assert made.reported[-1] == Params(width=3.3, strict=False, seed=5, inner=Inner("b"))
    assert made.panel.value == made.reported[-1]


@pytest.mark.parametrize(
    ("label", "moved", "taken"),
    [
        ("Count", 21, 20),  # a whole number stays one
        ("Count", 1, 1),  # rounds to 0, which is not allowed
        ("Reach", 0.06137, 0.0614),  # over decades it has three digits
    ],
)
def test_a_value_is_that_of_its_step(
    server: viser.ViserServer, label: str, moved: float, taken: float
) -> None:
    made = Made(server, Params())
    assert find(server, "Reach").step == pytest.approx(0.0001)
    user_sets(find(server, label), moved)
    reported = getattr(made.reported[-1], label.lower())
    assert (reported, type(reported)) == (taken, type(taken))
    assert made.errors == []


def test_chips_say_where_values_come_from_and_lead_back(server: viser.ViserServer) -> None:
    made = Made(server, Params())
    panel, bridge = made.panel, made.bridge
    ids = {name: uuid_of(find(server, name)) for name in ("Width", "Limit", "Reach")}

    def words() -> list[str]:
        return [made.numbers.chips[uuid].word for uuid in ids.values()]

    assert words() == ["default", "auto", "default"]
    user_sets(find(server, "Width"), 3.0)
    user_sets(find(server, "Limit"), 0.7)
    assert words() == ["set ↺", "set ↺", "default"]
    assert "the default, 2" in made.numbers.chips[ids["Width"]].hint
    html_says(bridge, "way-back", widget=ids["Limit"])
    assert words() == ["set ↺", "auto", "default"]
    html_says(bridge, "way-back", widget=ids["Width"])
    assert words() == ["default", "auto", "default"]
    assert made.reported[-1] == Params()
    html_says(bridge, "way-back", widget=ids["Width"])  # there is nothing to go back from
    html_says(bridge, "way-back", widget="another")
    assert len(made.reported) == 4
    panel.set(Params(), Params(reach=0.7))  # nobody asked for it: the points chose it
    assert words() == ["default", "auto", "auto"]
    panel.adapt(Params(width=1.5), ("reach",), {"limit": "each its own"})
    assert words()[0] == "set ↺"
    assert not find(server, "Reach").visible
    assert find(server, "each its own").value


def test_setting_shows_without_reporting_and_reset_goes_back(server: viser.ViserServer) -> None:
    made = Made(server, Params(width=9.0))
    assert find(server, "Width").max == 9.0  # a value beyond the slider stretches it
    made.panel.set(Params(width=0.5, limit=0.5, inner=Inner("b")))
    slider = find(server, "Width")
    assert (slider.value, slider.min, slider.max) == (0.5, 0.5, 5.0)  # 9 is no longer needed
    assert find(server, "Limit").value == 0.5
    assert not find(server, "no limit").value
    assert find(server, "Kind").value == "b"
    assert made.panel.reset() == Params(width=9.0)
    assert slider.value == 9.0
    made.panel.adapt(Params(width=1.5), (), {})
    assert made.panel.reset() == Params(width=1.5)
    assert made.reported == []


def test_a_value_beyond_a_slider_stretches_it_no_longer(server: viser.ViserServer) -> None:
    made = Made(server, Params())
    slider = find(server, "Width")
    user_sets(slider, 7.3)
    assert made.reported[-1].width == 7.3
    assert (slider.min, slider.max) == (1.0, 7.3)  # the page keeps what was typed
    user_sets(slider, 4.0)
    assert (slider.min, slider.max) == (1.0, 7.3)  # it may be under a hand
    user_sets(find(server, "Count"), 21)
    assert (slider.min, slider.max) == (1.0, 5.0)
    user_sets(slider, 0.5)
    made.panel.set(Params(width=3.0))
    assert (slider.min, slider.max) == (1.0, 5.0)


def test_a_typed_number_may_be_all_that_is_allowed(server: viser.ViserServer) -> None:
    made = Made(server, Params())
    answers: list[dict[str, object]] = []
    refused: list[str] = []
    made.bridge.call = lambda _, name, data: (  # type: ignore[method-assign]
        answers.append(data) if name != "heard" else None
    )
    made.numbers.refuse = refused.append
    slider = find(server, "Width")

    def types(text: str) -> None:
        html_says(made.bridge, "typed", widget=uuid_of(slider), text=text)

    types("7,3")
    assert (made.reported[-1].width, slider.value, slider.max) == (7.3, 7.3, 7.3)
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
    assert (made.moved, slider.value) == ([Params(width=4.0)], 4.0)
    assert made.panel.with_moved(Params(), uuid_of(slider), 3.04) == Params(width=3.0)
    assert made.panel.with_moved(Params(), "another", 3.0) == Params()


def test_a_refused_value_is_told_and_not_reported(server: viser.ViserServer) -> None:
    @dataclass(frozen=True)
    class Even:
        number: Annotated[int, Bounds(0, 10, 1), Doc("Even.")] = 2

        def __post_init__(self) -> None:
            if self.number % 2:
                raise InputError(f"number must be even, got {self.number}")

    reported: list[Even] = []
    errors: list[str] = []
    Panel(server, Even(), reported.append, on_error=errors.append)
    user_sets(find(server, "Number"), 3)
    user_sets(find(server, "Number"), 4)
    assert errors == ["number must be even, got 3"]
    assert reported == [Even(4)]


def test_an_automatic_parameter_shows_the_number_in_use(server: viser.ViserServer) -> None:
    made = Made(server, Params())
    box, slider = find(server, "no limit"), find(server, "Limit")
    assert (box.value, slider.disabled, slider.visible) == (True, True, False)  # without a number
    user_sets(box, False)
    assert made.reported.pop().limit == slider.value
    assert (slider.disabled, slider.visible) == (False, True)
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
