"""The index is what the contract with users promises."""

import inspect

import gpgrad_core as gg

TYPES = {
    *("SE2", "Submap", "Grid", "GradientMap", "Features", "Matches", "Registration"),
    *("LoopClosure", "LoopDetector", "Dataset", "PipelineParams", "MapParams"),
}
VERBS = {
    "load_dataset": ["path"],
    "infer_gradient_map": ["submap", "params"],
    "extract_features": ["gradient_map", "params"],
    "match_features": ["query", "database", "params"],
    "register": ["query", "database", "matches", "params"],
    "classify": ["registration", "params"],
    "detect_loop_closures": ["dataset", "params"],
    "build_pose_graph": ["dataset", "closures", "params"],
    "optimise_pose_graph": ["graph", "params"],
}


def test_every_name_of_the_index_is_there() -> None:
    assert all(hasattr(gg, name) for name in gg.__all__)
    assert TYPES | set(VERBS) <= set(gg.__all__)


def test_verbs_take_what_is_promised_in_its_order() -> None:
    for name, promised in VERBS.items():
        taken = list(inspect.signature(getattr(gg, name)).parameters)
        assert taken[: len(promised)] == promised


def test_params_have_the_promised_names_and_defaults() -> None:
    params = gg.MapParams(length_scale=0.3, noise_std=0.02, resolution=0.03)
    assert params.signal_std is None
    assert params.max_points is None
    assert params == gg.MapParams(length_scale=0.3, noise_std=0.02, resolution=0.03)
    assert hash(params) == hash(gg.MapParams(length_scale=0.3, noise_std=0.02, resolution=0.03))


def test_everything_public_is_explained() -> None:
    unexplained = [
        name
        for name in gg.__all__
        if name != "__version__" and not inspect.getdoc(getattr(gg, name))
    ]
    assert not unexplained
