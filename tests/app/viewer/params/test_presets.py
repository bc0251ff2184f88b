from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import viser

from app.viewer.params.presets import PresetsTool
from app.viewer.permissions import Permissions
from app.viewer.state import open_dataset, with_params
from gpgrad_core.pipeline import PipelineParams
from tests.app.desk import Recorder, make_desk
from tests.app.synthetic import make_dataset, needing
from tests.app.widgets import find, user_presses, user_sets

STATE = open_dataset(make_dataset(), PipelineParams())


@pytest.fixture
def recorder() -> Recorder:
    return Recorder()


def make(server: viser.ViserServer, recorder: Recorder, config: Path | None = None) -> PresetsTool:
    return PresetsTool(make_desk(server, STATE, recorder, Permissions(config=config)))


def gone_to(recorder: Recorder) -> list[PipelineParams]:
    return [state.asked for state in recorder.states]


def said(presets: PresetsTool) -> str:
    return presets._panel._message.content


def upload(server: viser.ViserServer, name: str, content: bytes) -> None:
    file: Any = viser.UploadedFile(name, content)
    user_sets(find(server, "Upload parameters"), file)


def test_the_list_points_at_what_the_parameters_are(
    server: viser.ViserServer, tmp_path: Path, recorder: Recorder
) -> None:
    presets = make(server, recorder, tmp_path)
    chosen = find(server, "Preset")
    assert chosen.value == "default"
    assert "stereo clouds" in presets._panel._purpose.content
    user_sets(chosen, "smooth ground")
    assert gone_to(recorder)[-1].map.length_scale == 0.45
    presets.follow(with_params(STATE, gone_to(recorder)[-1]))
    assert "half a metre" in presets._panel._purpose.content
    presets.follow(with_params(STATE, needing(7)))
    assert chosen.value == "custom"
    assert presets._panel._purpose.content == ""


def test_ones_own_are_kept_for_the_next_time(
    server: viser.ViserServer, tmp_path: Path, recorder: Recorder
) -> None:
    presets = make(server, recorder, tmp_path)
    presets.follow(with_params(STATE, needing(7)))
    user_sets(find(server, "Name"), "<b>")
    user_presses(find(server, "Save preset"))
    assert "cannot be a preset" in said(presets)
    assert "<b>'" not in said(presets)
    user_sets(find(server, "Name"), "seven")
    user_presses(find(server, "Save preset"))
    assert "seven.toml" in said(presets)
    assert find(server, "Preset").value == "seven"
    assert find(server, "Preset").options[-1] == "seven"
    presets.follow(STATE)
    user_sets(find(server, "Preset"), "seven")
    assert gone_to(recorder)[-1] == needing(7)
    presets.follow(with_params(STATE, needing(7)))
    user_presses(find(server, "Delete preset"))
    assert list((tmp_path / "presets").iterdir()) == []
    assert find(server, "Preset").value == "custom"


def test_a_file_of_parameters_is_taken_or_refused(
    server: viser.ViserServer, recorder: Recorder
) -> None:
    presets = make(server, recorder)
    assert not find(server, "Save preset").visible
    upload(server, "mine.toml", b"[closure]\nmin_inliers = 7\n")
    assert gone_to(recorder) == [replace(PipelineParams(), closure=needing(7).closure)]
    upload(server, "mine.toml", b"[closure]\nmin_inlier = 7\n")
    assert "did you mean closure.min_inliers?" in said(presets)
    upload(server, "mine.toml", b"\xff\xfe")
    assert "is not text in UTF-8" in said(presets)
    upload(server, "mine.toml", b"[closure")
    assert "is not TOML" in said(presets)
    upload(server, "mine.toml", b"#" * 200_000)
    assert "larger than 100,000 bytes" in said(presets)
    assert len(gone_to(recorder)) == 1
