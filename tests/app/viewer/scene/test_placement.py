from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from app.viewer.scene.associations import on_surface
from app.viewer.scene.cameras import place_on_screen
from app.viewer.scene.placement import (
    Box,
    Canvas,
    HeightFrame,
    Placement,
    frame_camera,
    glide,
    height_offset,
    level_of,
    place,
)
from app.viewer.scene.probing import Ray, first_hit
from app.viewer.session.state import FIELD_OF_VIEW, Camera, Layout, open_dataset
from gpgrad_core.detection import PipelineParams
from gpgrad_core.se2 import SE2
from tests.support.synthetic import T_DATABASE_QUERY, make_dataset, make_map, make_result

SUBMAPS = make_dataset().submaps
QUERY, DATABASE = SUBMAPS[3], SUBMAPS[0]
BOXES = Box.of(QUERY), Box.of(DATABASE)


def bounds(box: Box, placement: Placement) -> tuple[np.ndarray, np.ndarray]:
    corners = placement.apply(box.corners)
    return corners.min(axis=0), corners.max(axis=0)


def test_side_by_side_they_do_not_touch_and_surround_the_origin() -> None:
    query, database = place(*BOXES, "side by side", None, 0.0)
    query_low, query_high = bounds(BOXES[0], query)
    database_low, database_high = bounds(BOXES[1], database)
    assert query_high[0] < 0 < database_low[0]  # the query comes first
    assert database_high[0] == pytest.approx(-query_low[0], rel=0.05)
    assert query.yaw == database.yaw == 0.0


def test_side_by_side_with_a_motion_the_query_stands_in_the_databases_frame() -> None:
    together = place(*BOXES, "registered", T_DATABASE_QUERY, 0.4)
    apart = place(*BOXES, "side by side", T_DATABASE_QUERY, 0.4)
    points = np.random.default_rng(0).normal(0.0, 2.0, (20, 3))
    shift = apart[0].apply(points) - together[0].apply(points)
    np.testing.assert_allclose(shift, shift[:1].repeat(20, axis=0), atol=1e-9)
    assert apart[0].z - apart[1].z == pytest.approx(0.4)
    assert bounds(BOXES[0], apart[0])[1][0] < 0 < bounds(BOXES[1], apart[1])[0][0]


@given(
    yaw=st.floats(-3.0, 3.0),
    tilt=st.tuples(st.floats(-0.3, 0.3), st.floats(-0.3, 0.3)),
)
def test_a_tilted_frame_rises_and_stays_rigid(yaw: float, tilt: tuple[float, float]) -> None:
    placement = Placement(1.0, -2.0, 0.5, yaw, tilt)
    np.testing.assert_allclose(
        placement.pose.rotation @ placement.pose.rotation.T, np.eye(3), atol=1e-12
    )
    steepness = np.hypot(*tilt)
    if steepness > 1e-6:
        steepest = np.array([[*tilt, 0.0]]) / steepness
        rise = placement.apply(steepest)[0, 2] - 0.5
        assert rise == pytest.approx(np.sin(np.arctan(steepness)))
    flat = Placement(1.0, -2.0, 0.5, yaw).apply(np.array([[0.3, 0.4, 0.0]]))
    np.testing.assert_allclose(placement.apply(np.array([[0.3, 0.4, 0.0]])), flat, atol=0.3)


def test_the_level_of_a_tilted_submap_is_found_despite_what_has_changed() -> None:
    query_map, database_map = make_map(QUERY, 0.1), make_map(DATABASE, 0.1)
    grid = query_map.grid
    plane = -0.7 + 0.02 * grid.x[None, :] - 0.01 * grid.y[:, None]
    elevation = query_map.elevation + plane
    elevation[:6, :] += 1.5  # a wall that was not there before
    tilted = replace(query_map, elevation=elevation)
    found = make_result(open_dataset(make_dataset(), PipelineParams())).registration
    level = level_of(tilted, database_map, found, 0.5)
    assert level.height == pytest.approx(0.7, abs=0.02)
    assert level.tilt == pytest.approx((-0.02, 0.01), abs=0.006)
    assert level.yaw == T_DATABASE_QUERY.yaw
    far = replace(found, T_database_query=SE2(100.0, 0.0, 0.3), z_offset=0.2)
    assert level_of(tilted, database_map, far, 0.5) == HeightFrame(0.2, yaw=0.3)
    lost = replace(found, T_database_query=None)
    assert level_of(tilted, database_map, lost, 0.5) == HeightFrame()


def test_a_query_glides_from_where_it_stands_to_where_it_belongs() -> None:
    starts = place(*BOXES, "side by side", T_DATABASE_QUERY, 0.4, tilt=(0.02, 0.0))
    ends = place(*BOXES, "registered", T_DATABASE_QUERY, 0.4)
    for share, expected in ((0.0, starts), (1.0, ends)):
        made = glide(BOXES[0], starts, ends, share)
        for placement, wanted in zip(made, expected, strict=True):
            np.testing.assert_allclose(placement.position, wanted.position, atol=1e-9)
            assert (placement.yaw, placement.tilt) == (wanted.yaw, wanted.tilt)
    middle = BOXES[0].center[None]
    start, half, end = (
        placed[0].apply(middle)[0] for placed in (starts, glide(BOXES[0], starts, ends, 0.5), ends)
    )
    np.testing.assert_allclose(half[:2], (start + end)[:2] / 2, atol=1e-9)
    assert half[2] > (start + end)[2] / 2 + 0.5  # over the ground


def test_registered_a_query_point_lands_where_the_registration_says() -> None:
    query, database = place(*BOXES, "registered", T_DATABASE_QUERY, 0.4)
    points = np.array([[1.0, 2.0, 0.3], [-0.5, 0.0, -0.1]])
    in_database = np.column_stack([T_DATABASE_QUERY.apply(points[:, :2]), points[:, 2] + 0.4])
    np.testing.assert_allclose(query.apply(points), database.apply(in_database), atol=1e-12)


def test_without_a_registration_they_stand_side_by_side() -> None:
    assert place(*BOXES, "registered", None, 0.0) == place(*BOXES, "side by side", None, 0.0)


def test_the_offset_of_height_is_found_over_the_overlap_and_else_zero() -> None:
    query_map, database_map = make_map(QUERY), make_map(DATABASE)
    lowered = replace(query_map, elevation=query_map.elevation - 0.7)
    for motion, ratio, offset in (
        (T_DATABASE_QUERY, 0.5, 0.7),
        (T_DATABASE_QUERY, 1e-9, 0.0),
        (SE2(100.0, 0.0, 0.0), 0.5, 0.0),
    ):
        found = height_offset((lowered, database_map), motion, ratio)
        assert found == pytest.approx(offset, abs=0.02)


def project(camera: Camera, points: np.ndarray, aspect: float) -> np.ndarray:
    """Map scene points to the picture, whose edges are at -1 and 1."""
    eye = np.array(camera.position)
    forward = np.array(camera.look_at) - eye
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, [0, 0, 1])
    right /= np.linalg.norm(right)
    up = np.cross(right, forward)
    offset = points - eye
    depth = offset @ forward
    assert (depth > 0).all()
    half = np.tan(FIELD_OF_VIEW / 2)
    return np.column_stack([offset @ right / depth / (half * aspect), offset @ up / depth / half])


canvases = st.builds(
    Canvas,
    width=st.floats(400.0, 2000.0),
    height=st.floats(400.0, 1200.0),
    left=st.floats(0.0, 150.0),
    top=st.floats(0.0, 150.0),
    right=st.floats(0.0, 150.0),
    bottom=st.floats(0.0, 150.0),
)


@given(
    width=st.floats(1.0, 100.0),
    depth=st.floats(1.0, 100.0),
    height=st.floats(0.0, 10.0),
    layout=st.sampled_from(["side by side", "registered"]),
    canvas=canvases,
    tall=st.booleans(),
)
def test_the_camera_sees_both_submaps_in_the_free_part_of_the_canvas(
    width: float, depth: float, height: float, layout: Layout, canvas: Canvas, tall: bool
) -> None:
    box = Box((0.0, 0.0, 0.0), (width, depth, height))
    query, database = place(box, box, layout, T_DATABASE_QUERY, 0.0, tall=tall)
    camera = frame_camera(((box, query), (box, database)), canvas)
    corners = np.concatenate([query.apply(box.all_corners), database.apply(box.all_corners)])
    seen = project(camera, corners, canvas.aspect)
    (left, right), (bottom, top) = canvas.free_bounds
    low, high = seen.min(axis=0), seen.max(axis=0)
    assert (low >= (left - 1e-6, bottom - 1e-6)).all()  # nothing is cut off …
    assert (high <= (right + 1e-6, top + 1e-6)).all()
    filled = (high - low) / (right - left, top - bottom)
    assert filled.max() == pytest.approx(1.0, abs=1e-6)  # … and the window is not wasted
    np.testing.assert_allclose(  # nor is it to one side
        (low + high)[filled.argmin()], ((left + right), (bottom + top))[filled.argmin()], atol=0.3
    )


def test_from_any_side_all_of_it_is_seen() -> None:
    box, canvas = Box((0.0, 0.0, 0.0), (8.0, 3.0, 1.0)), Canvas(900.0, 600.0)
    for forward in ((0.0, 1.0, -1.0), (1.0, 0.2, -0.4), (0.0, 1e-3, -1.0), (0.0, 0.0, -1.0)):
        camera = frame_camera(((box, Placement()),), canvas, forward=np.array(forward))
        along = np.array(camera.look_at) - camera.position
        unit = np.array(forward) / np.linalg.norm(forward)
        np.testing.assert_allclose(along / np.linalg.norm(along), unit, atol=1e-9)
        if forward[:2] != (0.0, 0.0):
            assert np.abs(project(camera, box.all_corners, canvas.aspect)).max() < 1.0


def test_in_a_tall_canvas_the_query_stands_behind_the_database() -> None:
    query, database = place(*BOXES, "side by side", None, 0.0, tall=True)
    query_low, query_high = bounds(BOXES[0], query)
    database_low, database_high = bounds(BOXES[1], database)
    assert database_high[1] < 0 < query_low[1]
    assert query_high[1] == pytest.approx(-database_low[1], rel=0.05)
    assert Canvas(640.0, 900.0).is_tall
    assert not Canvas(1280.0, 1080.0).is_tall
    assert not Canvas(390.0, 844.0, bottom=506.0).is_tall  # what is free is wide


@pytest.mark.parametrize("layout", ["side by side", "registered"])
def test_exaggerated_ground_is_met_where_it_is_seen_and_read_as_it_is(layout: Layout) -> None:
    for index, ground in enumerate((make_map(QUERY), make_map(DATABASE))):
        flat, high = (
            place(*BOXES, layout, T_DATABASE_QUERY, 0.2, tilt=(0.01, 0.02), exaggeration=times)[
                index
            ]
            for times in (1.0, 3.0)
        )
        spots = on_surface(ground, np.array([[0.3, 0.4], [-0.2, 0.1]]))
        rises = [np.ptp(where.apply(spots)[:, 2]) for where in (flat, high)]
        assert rises[1] == pytest.approx(3.0 * rises[0], rel=0.05)
        middle = BOXES[index].center[None]
        low = flat.apply(middle)[0] * (1.0, 1.0, 3.0)
        np.testing.assert_allclose(high.apply(middle)[0], low, atol=1e-9)
        above = high.apply(spots[:1])[0] + np.array([0.0, 0.0, 20.0])
        ray = Ray(above, np.array([0.0, 0.0, -1.0]))
        hit = first_hit(ray, ground, high, np.ones(ground.grid.shape, bool))
        assert hit is not None
        assert (hit.x, hit.y) == pytest.approx((0.3, 0.4), abs=0.02)
        assert hit.distance == pytest.approx(20.0, abs=0.1)


def test_from_afar_lines_run_parallel_and_the_same_is_seen() -> None:
    box, canvas = Box((-4.0, -3.0, -1.0), (4.0, 3.0, 1.0)), Canvas(800.0, 600.0)
    down = np.array([0.0, 0.002, -1.0])
    afar = frame_camera(((box, Placement()),), canvas, forward=down, parallel=True)
    low, high = (place_on_screen(afar, canvas, np.array([[3.0, 2.0, z]]))[0] for z in (-1.0, 1.0))
    assert np.abs(low - high).max() < 4.0  # of 800 pixels, over 2 m of height
    near = afar.with_perspective
    ends = np.array([[3.0, 0.0, 0.0], [-3.0, 0.0, 0.0]])
    widths = [np.ptp(place_on_screen(view, canvas, ends)[:, 0]) for view in (afar, near)]
    assert widths[0] == pytest.approx(widths[1], rel=0.02)
    assert near.distance < 0.05 * afar.distance
