import pytest
import viser

from app.viewer.widgets.bridge import Bridge
from app.viewer.widgets.html import uuid_of
from app.viewer.widgets.numbers import Numbers, read_number
from gpgrad_core.errors import InputError
from gpgrad_core.params import Bounds
from tests.support.widgets import html_says

NOISE = Bounds(0.0005, 10.0, 0.005, "m", slider=(0.005, 0.3))
POINTS = Bounds(3, 10_000_000, 1, "points", slider=(500, 30_000))


@pytest.mark.parametrize(
    ("text", "number"),
    [("0,8", 0.8), ("0.8", 0.8), (" .5 ", 0.5), ("1.", 1.0), (",5", 0.5), ("1e-2", 0.01),
     ("0,125", 0.125), ("+2", 2.0), ("5,25", 5.25), ("0,8 m", 0.8), ("80 cm", 0.8),
     ("5mm", 0.005)],
)  # fmt: skip
def test_numbers_are_read_as_people_write_them(text: str, number: float) -> None:
    assert read_number(text, "Noise", NOISE, whole=False) == number


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("abc", "Noise must be a number such as 0.8, got 'abc'"),
        ("", "Noise must be a number such as 0.8, got nothing"),
        ("1 000", "Noise must be a number such as 0.8, got '1 000'"),
        ("nan", "Noise must be a number"),
        ("1_0", "Noise must be a number"),
        ("0.1.2", "Noise must be a number"),
        ("\u0663", "Noise must be a number"),
        ("9" * 5000, "Noise must be a number such as 0.8, got '9999"),
        ("-3", "Noise must be from 0.0005 to 10 m, got -3"),
        ("\N{MINUS SIGN}3", "Noise must be from 0.0005 to 10 m, got -3"),
        ("1e9", "Noise must be from 0.0005 to 10 m, got 1e9"),
        ("1e999", "Noise must be from 0.0005 to 10 m, got 1e999"),
        ("1,000", "Noise: '1,000' can be read in two ways; write 1000 or 1.000"),
    ],
)
def test_what_is_not_taken_is_said(text: str, said: str) -> None:
    with pytest.raises(InputError) as refusal:
        read_number(text, "Noise", NOISE, whole=False)
    assert str(refusal.value).startswith(said)
    assert len(str(refusal.value)) < 120


def test_whole_numbers_are_whole() -> None:
    taken = read_number("1e3", "Points", POINTS, whole=True)
    assert (taken, type(taken)) == (1000, int)
    assert read_number("-7", "Seed", whole=True) == -7
    for text, said in (
        ("12.5", "a whole number, got 12.5"),
        ("12,5", "two ways"),
        ("1e999", "from 3 to"),
    ):
        with pytest.raises(InputError, match=said):
            read_number(text, "Points", POINTS, whole=True)


def test_presses_are_told_in_order_and_nonsense_is_not(server: viser.ViserServer) -> None:
    bridge = Bridge(server)
    numbers = Numbers(server, bridge)
    rested: list[tuple[str, float | None]] = []
    numbers.rested = lambda widget, value: rested.append((widget, value))
    html_says(bridge, "rested", moves="a 0.5;b ;a 0.25")
    html_says(bridge, "rested", moves="a x;b 1")
    html_says(bridge, "rested", moves=None)
    html_says(bridge, "typed", widget="a", text="1")  # no box of ours
    html_says(bridge, "typed", widget=None, text="1")
    assert rested == [("a", 0.5), ("b", None), ("a", 0.25)]


def test_what_is_not_offered_takes_no_number(server: viser.ViserServer) -> None:
    bridge, taken = Bridge(server), list[float]()
    numbers = Numbers(server, bridge)
    box = server.gui.add_number("Noise [m]", 0.1)
    numbers.add(box, NOISE, taken.append)
    says = {"widget": uuid_of(box), "text": "0.2"}
    for name, offered in (("disabled", False), ("visible", True)):
        setattr(box, name, not offered)
        html_says(bridge, "typed", **says)
        setattr(box, name, offered)
        assert not taken
    html_says(bridge, "typed", **says)
    assert taken == [0.2]
