from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import viser
from hypothesis import given, settings
from hypothesis import strategies as st

from app.viewer.features.desk import Desk
from app.viewer.features.params.presets import (
    BUILT_IN,
    PresetsTool,
    delete_preset,
    own_presets,
    preset_text,
    save_preset,
)
from app.viewer.server.limits import Permissions
from app.viewer.session.state import open_dataset
from gpgrad_core.detection import PipelineParams
from gpgrad_core.errors import InputError
from gpgrad_core.mapping.gradient_map import MapParams
from gpgrad_core.methods.paper import paper_params
from gpgrad_core.params import read_parameters
from tests.support.desk import make_desk
from tests.support.synthetic import make_dataset, needing
from tests.support.widgets import find, said, user_presses, user_sets

OTHERS = PipelineParams(map=MapParams(length_scale=0.42, signal_std=0.3, max_points=7000))


def test_built_in_presets_differ_and_say_what_they_are_for() -> None:
    assert [preset.name for preset in BUILT_IN] == [
        "default",
        "paper",
        "rough ground",
        "smooth ground",
    ]
    assert len({preset.params for preset in BUILT_IN}) == len(BUILT_IN)
    assert all(len(preset.purpose) > 40 for preset in BUILT_IN)
    assert BUILT_IN[0].params == PipelineParams()
    assert BUILT_IN[1].params == paper_params(PipelineParams())
    rough, usual, smooth = (
        preset.params.map.guessed.terrain for preset in (BUILT_IN[2], BUILT_IN[0], BUILT_IN[3])
    )
    assert rough.length_scale < usual.length_scale < smooth.length_scale


@settings(max_examples=30)
@given(
    length_scale=st.floats(0.01, 100.0),
    signal_std=st.none() | st.floats(0.001, 1000.0),
    seed=st.integers(0, 10**9),
)
def test_a_preset_is_read_as_the_flag_does_whatever_lies_below(
    tmp_path_factory: pytest.TempPathFactory,
    length_scale: float,
    signal_std: float | None,
    seed: int,
) -> None:
    params = replace(
        PipelineParams(),
        map=MapParams(length_scale=length_scale, signal_std=signal_std),
        registration=replace(PipelineParams().registration, seed=seed),
    )
    path = tmp_path_factory.mktemp("preset") / "mine.toml"
    path.write_text(preset_text("mine", params), encoding="utf-8")
    assert read_parameters(path, OTHERS) == params
    assert read_parameters(path, PipelineParams()) == params


def test_own_presets_are_saved_replaced_and_deleted(tmp_path: Path) -> None:
    folder = tmp_path / "not" / "yet"
    assert own_presets(folder) == ((), ())
    save_preset(folder, "Etna (noisy)", PipelineParams())
    saved = save_preset(folder, "Etna (noisy)", OTHERS)
    (preset,), notes = own_presets(folder)
    assert preset == saved
    assert (preset.name, preset.params, notes) == ("Etna (noisy)", OTHERS, ())
    assert str(folder / "Etna (noisy).toml") in preset.purpose
    delete_preset(folder, "Etna (noisy)")
    assert own_presets(folder) == ((), ())
    with pytest.raises(InputError, match="not one of your own"):
        delete_preset(folder, "Etna (noisy)")


@pytest.mark.parametrize(
    "name", ["", "../evil", "a/b", ".hidden", "x" * 61, "new\nline", "dot.", "paper", "a\\b", "C:x"]
)
def test_a_name_that_is_no_file_name_is_refused(tmp_path: Path, name: str) -> None:
    with pytest.raises(InputError):
        save_preset(tmp_path, name, PipelineParams())
    assert list(tmp_path.iterdir()) == []


def test_only_so_many_are_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("app.viewer.features.params.presets.MOST", 2)
    for name in ("one", "two", "two"):
        save_preset(tmp_path, name, OTHERS)
    with pytest.raises(InputError, match="There are 2 presets, which is the most"):
        save_preset(tmp_path, "three", OTHERS)
    delete_preset(tmp_path, "one")
    save_preset(tmp_path, "three", OTHERS)


def test_a_broken_preset_is_told_and_the_others_are_there(tmp_path: Path) -> None:
    save_preset(tmp_path, "good", OTHERS)
    (tmp_path / "bad.toml").write_text("[map]\nlength_scale = -1\n")
    presets, notes = own_presets(tmp_path)
    assert [preset.name for preset in presets] == ["good"]
    assert len(notes) == 1
    assert "bad.toml" in notes[0]


STATE = open_dataset(make_dataset(), PipelineParams())


@pytest.fixture
def desk(server: viser.ViserServer, tmp_path: Path) -> Desk:
    made = make_desk(server, STATE, permissions=Permissions(config=tmp_path))
    made.join(PresetsTool(made, PipelineParams()))
    return made


def upload(server: viser.ViserServer, content: bytes) -> None:
    file: Any = viser.UploadedFile("mine.toml", content)
    user_sets(find(server, "Upload parameters"), file)


def test_the_list_points_at_what_the_parameters_are(desk: Desk, server: viser.ViserServer) -> None:
    chosen = find(server, "Preset")
    assert chosen.value == "default"
    assert "stereo clouds" in said(server)
    user_sets(chosen, "smooth ground")
    assert desk.state.asked.map.length_scale == 0.45
    assert "half a metre" in said(server)
    desk.change(params=needing(7))
    assert chosen.value == "custom"
    assert "half a metre" not in said(server)


def test_what_a_dataset_was_opened_with_is_its_default(server: viser.ViserServer) -> None:
    preferred = needing(7)
    desk = make_desk(server, open_dataset(make_dataset(), preferred))
    tool = desk.join(PresetsTool(desk, preferred))
    chosen = find(server, "Preset")
    assert chosen.value == "default"
    assert "opened with" in tool.purpose.content
    desk.change(params=needing(9))
    assert chosen.value == "custom"
    user_sets(chosen, "default")
    assert desk.state.asked == preferred


def test_ones_own_are_kept(desk: Desk, server: viser.ViserServer, tmp_path: Path) -> None:
    desk.change(params=needing(7))
    user_sets(find(server, "Name"), "<b>")
    user_presses(find(server, "Save preset"))
    assert "cannot be a preset" in said(server, "preset-message")
    assert "<b>'" not in said(server, "preset-message")
    user_sets(find(server, "Name"), "seven")
    user_presses(find(server, "Save preset"))
    assert "seven.toml" in said(server, "preset-message")
    assert find(server, "Preset").value == "seven"
    assert find(server, "Preset").options[-1] == "seven"
    desk.change(params=STATE.asked)
    user_sets(find(server, "Preset"), "seven")
    assert desk.state.asked == needing(7)
    user_presses(find(server, "Delete preset"))
    assert list((tmp_path / "presets").iterdir()) == []
    assert find(server, "Preset").value == "custom"


def test_a_file_of_parameters_is_taken_or_refused(server: viser.ViserServer) -> None:
    desk = make_desk(server, STATE, permissions=Permissions())
    desk.join(PresetsTool(desk, PipelineParams()))
    assert not find(server, "Save preset").visible
    upload(server, b"[closure]\nmin_inliers = 7\n")
    taken = replace(PipelineParams(), closure=needing(7).closure)
    assert desk.state.asked == taken
    for content, words in (
        (b"[closure]\nmin_inlier = 7\n", "did you mean closure.min_inliers?"),
        (b"\xff\xfe", "is not text in UTF-8"),
        (b"[closure", "is not TOML"),
        (b"#" * 200_000, "larger than 100,000 bytes"),
    ):
        upload(server, content)
        assert words in said(server, "preset-message")
    assert desk.state.asked == taken


def test_a_folder_that_cannot_be_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """In the home of another, no session could begin."""

    def refuse(*_: object) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(Path, "glob", refuse)
    assert own_presets(tmp_path) == ((), (f"{tmp_path}: Permission denied",))
    with pytest.raises(InputError, match="cannot be written: Permission denied"):
        save_preset(tmp_path, "mine", PipelineParams())
