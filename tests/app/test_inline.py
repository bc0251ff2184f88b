"""The viewer's scene in a notebook."""

import pytest

from app.inline import scene_of_pair
from gpgrad_core.errors import InputError
from tests.core.pages.walk import PARAMS, walk


def test_a_pair_is_a_page_of_viser_in_a_frame(capsys: pytest.CaptureFixture[str]) -> None:
    dataset, _ = walk()
    shown = scene_of_pair(dataset, "008", "000", PARAMS)
    assert "submap 008 onto 000" in shown.page
    assert capsys.readouterr().out == ""
    assert shown._repr_html_().startswith("<iframe srcdoc=")
    with pytest.raises(InputError, match="has no submap 'x'"):
        scene_of_pair(dataset, "x", "000", PARAMS)
