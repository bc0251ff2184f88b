"""A stage's progress within that of the whole."""

import pytest

from gpgrad_core.run.progress import Cancelled, part


def test_a_stage_reports_into_its_stretch_and_stages_nest() -> None:
    heard: list[float] = []
    inner = part(part(heard.append, 0.5, 1.0), 0.0, 0.5)
    for fraction in (0.0, 0.5, 1.0):
        inner(fraction)
    assert heard == [0.5, 0.625, 0.75]


def test_cancelling_passes_through() -> None:
    def stop(fraction: float) -> None:
        raise Cancelled(str(fraction))

    with pytest.raises(Cancelled, match=r"0\.5"):
        part(stop, 0.0, 1.0)(0.5)
