"""Seconds of each stage for one pair, and of a whole dataset.

``poe bench``
"""

import pytest
from pytest_benchmark.fixture import BenchmarkFixture

from gpgrad_core.detection import (
    PipelineParams,
    detect_loop_closures,
    infer_gradient_map,
    register_pair,
)
from gpgrad_core.features import DetectorParams, FeatureParams, detect_features, extract_features
from gpgrad_core.io.folder import load_dataset
from gpgrad_core.mapping.gradient_map import MapParams, fit_terrain, sample_map
from gpgrad_core.matching import match_features
from gpgrad_core.registration import register
from gpgrad_core.run.memo import Memo
from gpgrad_core.simulation.demo import demo_path
from gpgrad_core.types import Dataset, GradientMap, Submap

PARAMS = PipelineParams(map=MapParams().guessed)


@pytest.fixture(scope="module")
def demo() -> Dataset:
    return load_dataset(demo_path())


@pytest.fixture(scope="module")
def pair(demo: Dataset) -> tuple[Submap, Submap]:
    return demo.submap(str(demo.preferred["query"])), demo.submap(str(demo.preferred["database"]))


@pytest.fixture(scope="module")
def maps(pair: tuple[Submap, Submap]) -> tuple[GradientMap, GradientMap]:
    query, database = (infer_gradient_map(submap, PARAMS.map) for submap in pair)
    return query, database


def test_fit(benchmark: BenchmarkFixture, pair: tuple[Submap, Submap]) -> None:
    benchmark(fit_terrain, pair[0], PARAMS.map.terrain)


def test_sample(benchmark: BenchmarkFixture, pair: tuple[Submap, Submap]) -> None:
    posterior = fit_terrain(pair[0], PARAMS.map.terrain)
    benchmark(sample_map, pair[0], posterior, PARAMS.map.resolution)


@pytest.mark.parametrize("name", ["slope", "akaze", "sift"])
def test_detect(
    benchmark: BenchmarkFixture, maps: tuple[GradientMap, GradientMap], name: str
) -> None:
    benchmark(detect_features, maps[0], DetectorParams(name))


@pytest.mark.parametrize("name", ["slope", "akaze", "sift"])
def test_match(
    benchmark: BenchmarkFixture, maps: tuple[GradientMap, GradientMap], name: str
) -> None:
    params = FeatureParams(detector=DetectorParams(name))
    query, database = (extract_features(made, params) for made in maps)
    benchmark(match_features, query, database, PARAMS.matching)


def test_register(benchmark: BenchmarkFixture, maps: tuple[GradientMap, GradientMap]) -> None:
    query, database = (extract_features(made, PARAMS.features) for made in maps)
    matches = match_features(query, database, PARAMS.matching)
    benchmark(register, *maps, matches, PARAMS.registration)


def test_a_pair_from_the_memo(benchmark: BenchmarkFixture, pair: tuple[Submap, Submap]) -> None:
    memo = Memo()
    register_pair(*pair, PARAMS, memo)
    benchmark(register_pair, *pair, PARAMS, memo)


def test_the_demo_whole(benchmark: BenchmarkFixture, demo: Dataset) -> None:
    result = benchmark.pedantic(detect_loop_closures, (demo, PARAMS), rounds=3, iterations=1)
    benchmark.extra_info.update(result.seconds)
