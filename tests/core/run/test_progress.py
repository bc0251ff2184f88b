"""A stage's progress within that of the whole."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gpgrad_core.run.progress import Cancelled, part

fractions = st.floats(0, 1)


@given(fractions, fractions, fractions)
def test_a_stage_reports_into_its_stretch(start: float, stop: float, fraction: float) -> None:
    start, stop = sorted((start, stop))
    heard: list[float] = []
    part(heard.append, start, stop)(fraction)
    assert len(heard) == 1
    assert start <= heard[0] <= stop + 1e-12


def test_both_ends_arrive_and_stages_nest() -> None:
    heard: list[float] = []
    inner = part(part(heard.append, 0.5, 1.0), 0.0, 0.5)
    inner(0.0)
    inner(1.0)
    assert heard == [0.5, 0.75]


def test_cancelling_passes_through() -> None:
    def stop(fraction: float) -> None:
        raise Cancelled(str(fraction))

    with pytest.raises(Cancelled, match=r"0\.5"):
        part(stop, 0.0, 1.0)(0.5)
