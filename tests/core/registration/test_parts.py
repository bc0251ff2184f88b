"""Search, alignment and evidence, each by itself."""

import math
from dataclasses import astuple, replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gpgrad_core.registration.align import (
    DRIFT_RISE,
    DRIFT_SHIFT,
    DRIFT_TURN,
    DRIFTED,
    LEVEL,
    Alignment,
    Warp,
    align,
    align_all,
)
from gpgrad_core.registration.candidates import NUM_YAWS, cells_for, make_spectra, search_motions
from gpgrad_core.registration.score import (
    UNRELATED_LEVEL,
    UNRELATED_SPREAD,
    Evidence,
    closure_score,
    map_agreement,
    rough_evidence,
    shares_of_evidence,
    weigh,
)
from gpgrad_core.registration.surface import (
    NUM_BANDS,
    Surface,
    band_edges,
    band_noise,
    sharp_surface,
    smooth_surface,
)
from gpgrad_core.se2 import SE2
from gpgrad_core.types import Agreement, GradientMap, Grid
from tests.core.registration.synthetic import DATABASE, GRID, GROUND, map_of
from tests.support.ground import Ground
from tests.support.laws import examples

SURFACE = smooth_surface(DATABASE)


def distance(found: SE2, true: SE2) -> float:
    middle = np.zeros((1, 2))
    return float(np.hypot(*(found.apply(middle) - true.apply(middle))[0]))


def test_the_search_transforms_a_smaller_map_like_the_larger_one() -> None:
    true = SE2(0.3, -0.4, 0.7)
    whole = smooth_surface(map_of(true))
    rows, columns = whole.grid.shape
    inner = np.zeros((rows, columns), bool)
    inner[rows // 5 : -rows // 5, columns // 5 : -columns // 5] = True
    part = replace(whole, trusted=whole.trusted & inner)
    assert cells_for(part)[1] < cells_for(part, SURFACE)[1] == cells_for(SURFACE)[1]
    assert distance(search_motions(part, SURFACE, 3)[0], true) < 0.6


def test_the_search_on_plain_ground_finds_nothing() -> None:
    plain = smooth_surface(map_of(SE2(), Ground.random(0, std=0.0)))
    assert search_motions(plain, SURFACE, 3) == []


def test_cells_grow_on_wide_maps() -> None:
    grid = Grid((0.0, 0.0), 0.5, (160, 160))
    zero = np.zeros(grid.shape)
    wide = smooth_surface(GradientMap(grid, zero, zero, np.zeros((160, 160, 2)), 0.15, 0.3))
    spectra = make_spectra(wide, NUM_YAWS, *cells_for(wide))
    assert spectra.cell >= 1.2
    assert 2 * spectra.half <= 70


@examples(6)
@given(
    x=st.floats(-0.3, 0.3),
    y=st.floats(-0.3, 0.3),
    turn=st.floats(-0.1, 0.1),
    tilt=st.floats(-0.005, 0.005),
)
def test_alignment_ends_at_the_truth_also_where_the_query_leans(
    x: float, y: float, turn: float, tilt: float
) -> None:
    true = SE2(0.6, -0.4, 1.0)
    query = map_of(true)
    leaning = query.elevation + tilt * query.grid.x
    surface = smooth_surface(replace(query, elevation=leaning))
    start = SE2(true.x + x, true.y + y, true.yaw + turn)
    for begin in (start, true):
        end = align(surface, SURFACE, begin, num_cells=2000, iterations=10)
        assert end.held
        assert distance(end.motion, true) < 0.02
        assert abs(end.motion.yaw - true.yaw) < 0.005
        assert end.z_offset == pytest.approx(0.0, abs=0.03)
    both = align_all(surface, SURFACE, [start, true], num_cells=2000, iterations=10)
    assert max(distance(both.motion(k), true) for k in range(2)) < 0.02


def test_alignment_of_drifted_maps_bears_a_bend_that_a_level_one_takes_for_a_motion() -> None:
    true = SE2(0.6, -0.4, 1.0)
    query = map_of(true)
    x, y = query.grid.x, query.grid.y[:, None]
    bent = query.elevation + 0.02 * x + 0.006 * x**2 - 0.004 * x * y
    slope = query.slope + np.stack(
        np.broadcast_arrays(0.02 + 0.012 * x - 0.004 * y, -0.004 * x), axis=-1
    )
    surface = sharp_surface(replace(query, elevation=bent, slope=slope))
    database = sharp_surface(DATABASE)
    off: dict[Warp, float] = {}
    for warp in (LEVEL, DRIFTED):
        end = align(surface, database, true, num_cells=3000, iterations=8, warp=warp)
        off[warp] = distance(end.motion, true)
    assert off[DRIFTED] < 0.01
    assert off[DRIFTED] < 0.3 * off[LEVEL]


def test_covariances_cover_the_errors_and_shrink_with_the_noise() -> None:
    true = SE2(0.2, 0.1, 0.4)
    query = map_of(true)
    rng = np.random.default_rng(0)
    sizes: list[float] = []
    for noise in (0.01, 0.04):
        errors: list[float] = []
        size = 0.0
        for _ in range(10):
            noisy = query.elevation + noise * rng.standard_normal(query.grid.shape)
            surface = smooth_surface(replace(query, elevation=noisy))
            end = align(surface, SURFACE, true, num_cells=2000, iterations=5)
            left = np.subtract(astuple(end.motion), astuple(true))
            errors.append(float(left @ np.linalg.solve(end.covariance, left)))
            size = float(np.trace(end.noise[:2, :2]))
        sizes.append(size)
        assert np.median(errors) < 3  # of three squares
    assert sizes[1] > 2 * sizes[0]


TILTED_BY = SE2(0.2, 0.1, 0.4)


@pytest.fixture(scope="module")
def level_and_tilted() -> list[Surface]:
    level = map_of(TILTED_BY)
    tilted = replace(
        level,
        elevation=level.elevation + 0.01 * level.grid.x,
        slope=level.slope + np.array([0.01, 0.0]),
    )
    return [sharp_surface(each) for each in (level, tilted)]


WIDTH = np.sqrt(GRID.num_cells) * GRID.resolution


def drifted(query: Surface, database: Surface) -> Alignment:
    return align(query, database, TILTED_BY, num_cells=3000, iterations=5, warp=DRIFTED)


def test_maps_that_tilt_against_each_other_have_drifted(level_and_tilted: list[Surface]) -> None:
    rigid, tilted = (drifted(each, sharp_surface(DATABASE)) for each in level_and_tilted)
    whole = (DRIFT_SHIFT * WIDTH) ** 2
    assert rigid.drift[0, 0] < 0.2 * whole < 0.9 * whole < tilted.drift[0, 0]
    assert 0.9 * DRIFT_TURN**2 < tilted.drift[2, 2] < DRIFT_TURN**2
    assert rigid.z_std < 0.5 * DRIFT_RISE * WIDTH < 0.95 * DRIFT_RISE * WIDTH < tilted.z_std


def test_heights_are_less_certain_in_the_middle_of_a_map_far_from_the_overlap(
    level_and_tilted: list[Surface],
) -> None:
    count = GRID.shape[0] // 3
    first_rows = GradientMap(
        replace(GRID, shape=(count, GRID.shape[1])),
        *(each[:count].copy() for each in (DATABASE.elevation, DATABASE.variance, DATABASE.slope)),
        *(DATABASE.signal_std, DATABASE.length_scale, DATABASE.scale),
    )
    whole, part = (
        drifted(level_and_tilted[1], sharp_surface(each)) for each in (DATABASE, first_rows)
    )
    # Each of the maps has half of the tilt's variance, and half of that is along the way.
    way = np.linalg.norm(np.subtract(part.middle, sharp_surface(DATABASE).disc[0]))
    by_tilt, by_drift = 0.01 * way / 2, DRIFT_RISE * WIDTH
    assert part.z_std == pytest.approx(np.hypot(by_tilt, by_drift), rel=0.25)
    assert whole.z_std < np.hypot(0.5 * by_tilt, by_drift)


def test_alignment_leaves_alone_what_does_not_meet() -> None:
    for away in (SE2(40.0, 0.0, 0.3), SE2(1000.0, 0.0, 0.5)):
        end = align(SURFACE, SURFACE, away, num_cells=500, iterations=3)
        assert (end.held, end.motion) == (False, away)
        ends = align_all(SURFACE, SURFACE, [away, SE2()], num_cells=500, iterations=3)
        assert ends.motion(0) == away
        assert ends.likeness[0] == 0.0 < ends.likeness[1]


def test_a_map_agrees_with_itself_and_not_with_another() -> None:
    (same,) = weigh(SURFACE, SURFACE, [SE2()])
    assert min(same.log_ratios) > 1.0
    # 8 m x 8 m of ground in patches of 2 pi 0.3 m x 0.3 m.
    assert same.patches == pytest.approx(64 / (2 * math.pi * 0.09), rel=0.1)
    assert same.agreement is not None
    assert same.agreement.difference == pytest.approx(0.0, abs=1e-4)
    assert same.agreement.difference < same.agreement.possible < same.agreement.relief
    unrelated = smooth_surface(map_of(SE2(), Ground.random(99, shortest=1.0)))
    (other,) = weigh(unrelated, SURFACE, [SE2()])
    assert other.log_ratios[0] < 0
    assert other.agreement is not None
    assert other.agreement.difference > 3 * other.agreement.possible


def test_the_map_of_the_evidence_adds_up_to_what_is_scored() -> None:
    true = SE2(1.0, -0.7, 2.0)
    query = map_of(true)
    surface = smooth_surface(query)
    grid, shown = map_agreement(query, DATABASE, true)
    (evidence,) = weigh(surface, SURFACE, [true])
    count = np.isfinite(shown).sum()
    assert grid.shape == shown.shape
    assert count * grid.resolution**2 / (2 * math.pi * SURFACE.scale**2) == evidence.patches
    of_terrain = shares_of_evidence(evidence, 0)[1:]
    assert np.nanmean(shown) * math.sqrt(evidence.patches) == pytest.approx(sum(of_terrain))
    # The cells lie where the maps overlap, in the database's frame.
    rows, columns = np.nonzero(np.isfinite(shown))
    places = grid.to_position(np.column_stack([columns, rows]).astype(float))
    assert surface.grid.to_pixel(true.inverse().apply(places)).min() > -1
    assert SURFACE.grid.to_pixel(places).min() > -0.001
    nowhere = map_agreement(query, DATABASE, SE2(100.0, 0.0, 0.0))[1]
    assert np.isnan(nowhere).all()


def test_motions_weighed_together_are_weighed_as_alone() -> None:
    motions = [SE2(), SE2(100.0), SE2(2.0, 1.0, 0.5), SE2(-3.0, 0.5, -2.0)]
    together = weigh(SURFACE, SURFACE, motions)
    assert together[1].patches == 0
    assert together[1].agreement is None
    for motion, evidence in zip(motions, together, strict=True):
        (alone,) = weigh(SURFACE, SURFACE, [motion])
        assert evidence.patches == alone.patches
        assert evidence.log_ratios == pytest.approx(alone.log_ratios, abs=1e-5)


def test_the_evidence_asks_for_the_same_height() -> None:
    steeper = smooth_surface(
        map_of(SE2(), Ground(GROUND.wave_vectors, GROUND.phases, 1.5 * GROUND.amplitudes))
    )
    of_same, of_steeper = (weigh(one, SURFACE, [SE2()])[0] for one in (SURFACE, steeper))
    assert of_steeper.log_ratios[0] < 0.5 * of_same.log_ratios[0]
    assert of_steeper.log_ratios[1] < 0.5 * of_same.log_ratios[1]


def test_equal_heights_are_the_most_evidence_and_noise_lowers_it() -> None:
    motions = np.array([[0.0, 0.0, 0.0], [1.5, 0.4, 0.3], [90.0, 0.0, 0.0]])
    sure, unsure = (
        rough_evidence(surface, surface, motions, 600)
        for surface in (
            smooth_surface(replace(DATABASE, variance=np.full(GRID.shape, std**2)), 1.0)
            for std in (0.005, 0.1)
        )
    )
    for evidence in (sure, unsure):
        assert evidence[0] > max(evidence[1], 0)
        assert evidence[2] == 0  # nothing is common
    assert sure[0] > 2 * unsure[0]


def test_flat_ground_says_nothing() -> None:
    flat = smooth_surface(map_of(SE2(), Ground.random(5, shortest=1.0, std=0.0005)))
    assert max(np.abs(weigh(flat, flat, [SE2()])[0].log_ratios)) < 0.3


def test_a_rock_that_moved_does_not_decide() -> None:
    moved = DATABASE.elevation.copy()
    moved[30:36, 30:36] += 0.5
    (with_rock,) = weigh(smooth_surface(replace(DATABASE, elevation=moved)), SURFACE, [SE2()])
    assert min(with_rock.log_ratios) > 0.5


def test_tilt_and_bend_of_a_submap_do_not_count_as_a_difference() -> None:
    x, y = GRID.x, GRID.y[:, None]
    bent = replace(DATABASE, elevation=DATABASE.elevation + 0.02 * x - 0.01 * y + 0.003 * x * y)
    said, same = (weigh(one, SURFACE, [SE2()])[0] for one in (smooth_surface(bent), SURFACE))
    assert said.log_ratios == pytest.approx(same.log_ratios, abs=0.3)


def test_weighing_the_other_way_round_says_the_same() -> None:
    true = SE2(1.0, -0.7, 2.0)
    surface = smooth_surface(map_of(true))
    (forth,), (back,) = (
        weigh(surface, SURFACE, [true]),
        weigh(SURFACE, surface, [true.inverse()]),
    )
    assert forth.log_ratios == pytest.approx(back.log_ratios, abs=0.1)
    assert forth.patches == pytest.approx(back.patches, rel=0.1)


def test_the_noise_of_a_band_is_that_of_dense_noisy_points() -> None:
    """White noise of a known density, smoothed as the posterior mean smooths it."""
    density, rng = 2e-5, np.random.default_rng(3)
    signal, length, scale, cell = 0.3, 1.0, 0.3, 0.05
    grid = Grid((0.0, 0.0), cell, (400, 400))
    strongest = 2 * math.pi * (signal * length) ** 2
    variance = density / (2 * math.pi * length**2) * math.log1p(strongest / density)
    made = GradientMap(
        grid,
        np.zeros(grid.shape),
        np.full(grid.shape, variance),
        np.zeros((*grid.shape, 2)),
        *(signal, length, scale),
    )
    k = 2 * np.pi * np.hypot(*np.meshgrid(np.fft.fftfreq(400, cell), np.fft.fftfreq(400, cell)))
    power = strongest * np.exp(-0.5 * (k * length) ** 2)
    white = np.fft.fft2(rng.standard_normal(grid.shape) * math.sqrt(density) / cell)
    told = band_noise(made, made.variance[:1, :1])[0, 0]
    for band in range(NUM_BANDS):
        fine, coarse = band_edges(scale, band)
        through = np.exp(-0.5 * (k * fine) ** 2) - np.exp(-0.5 * (k * coarse) ** 2)
        drawn = np.fft.ifft2(white * power / (power + density) * through).real.var()
        assert told[band] == pytest.approx(drawn, rel=0.15)


@given(st.floats(0.1, 1000), st.floats(-3, 3), st.floats(-3, 3), st.integers(0, 500))
def test_the_score_is_its_formula(patches: float, first: float, second: float, num: int) -> None:
    total = math.sqrt(patches) * (first + 0.5 * second / 2) + 3 * math.log(1 + num)
    tail = math.exp(min(-(total - UNRELATED_LEVEL) / UNRELATED_SPREAD, 700.0))
    chance = -math.expm1(-tail)
    expected = max(0.0, -math.log10(chance)) if chance > 0 else 300.0
    score = closure_score(Evidence(patches, (first, second), Agreement(0.01, 0.01, 0.1)), num)
    assert score == pytest.approx(expected, rel=1e-9, abs=1e-12)
    assert closure_score(Evidence(patches, (first, second)), num) == 0.0
