"""Side by side, the same place looks the same.

Truth chooses the pairs and matches the cells; the picture knows only what was registered.
"""

import csv
from dataclasses import replace
from pathlib import Path

import numpy as np
import viser
from scipy.spatial import cKDTree

from app.viewer.features.pair.scene import PairScene
from app.viewer.scene.associations import ARC_PIECES
from app.viewer.session.state import ViewOptions, ViewState, open_dataset, with_pair
from gpgrad_core.detection import (
    PipelineParams,
    register_pair,
    resolve_parameters,
)
from gpgrad_core.io.folder import load_dataset
from gpgrad_core.run.memo import Memo
from gpgrad_core.se2 import SE2
from gpgrad_core.types import Dataset
from tests.long.quality.colours import ciede2000, lab_of
from tests.support.server import started_server
from tests.support.widgets import node

SETS = ("marsyard2021", "sthelens", "apollo15", "hillside", "ridges")
PAIRS = 5
"""Of each set, spread over those that share much ground."""
LOOKS = {
    "before": ViewOptions(layer="elevation", raw_frames=True),
    "now": ViewOptions(),
    "the elevation now": ViewOptions(layer="elevation"),
}
"""What is shown first, and was before: each submap in its own frame."""


def test_colour_differences_are_those_that_were_published() -> None:
    """The pairs are 1, 7, 13, 20 and 34 of the test data of Sharma, Wu and Dalal (2005)."""
    pairs = np.array(
        [
            (50.0, 2.6772, -79.7751, 50.0, 0.0, -82.7485, 2.0425),
            (50.0, 0.0, 0.0, 50.0, -1.0, 2.0, 2.3669),
            (50.0, 2.49, -0.001, 50.0, -2.49, 0.0009, 7.1792),
            (50.0, 2.5, 0.0, 73.0, 25.0, -18.0, 27.1492),
            (6.7747, -0.2908, -2.4247, 5.8714, -0.0985, -2.2286, 0.6377),
        ]
    )
    found = ciede2000(pairs[:, :3], pairs[:, 3:6])
    np.testing.assert_allclose(found, pairs[:, 6], atol=1e-4)


def test_colours_match_and_lines_are_parallel(real_data: Path) -> None:
    """Where both drove the same way, as in three of the five pairs of ridges, they did before."""
    colours: dict[str, list[np.ndarray]] = {look: [] for look in LOOKS}
    for name in SETS:
        with started_server() as server:
            seen, angles = look_at(real_data / name, server)
        medians = {look: float(np.median(np.concatenate(some))) for look, some in seen.items()}
        figures = ", ".join(f"{value:.2f} {look}" for look, value in medians.items())
        print(f"\n{name}: {len(angles)} pairs; CIEDE2000 of matched cells {figures}")
        print(f"lines deviate from their mean direction by {np.median(angles):.1f} degrees")
        assert len(angles) >= 3
        assert medians["the elevation now"] <= medians["before"] / 3
        assert np.median(angles) <= 15.0
        for look, some in seen.items():
            colours[look] += some
    before, now = (np.median(np.concatenate(colours[look])) for look in ("before", "now"))
    print(f"\nall: CIEDE2000 {before:.2f} before, {now:.2f} now")
    assert now <= before / 3


def look_at(
    folder: Path, server: viser.ViserServer
) -> tuple[dict[str, list[np.ndarray]], list[float]]:
    """Show true pairs of a set in all looks: differences of colours, and angles of lines."""
    dataset, memo = load_dataset(folder), Memo()
    params = resolve_parameters(dataset.submaps, PipelineParams(), memo)
    scene = PairScene(server, standalone=False)
    seen: dict[str, list[np.ndarray]] = {look: [] for look in LOOKS}
    angles: list[float] = []
    for query_id, database_id in true_pairs(dataset, folder / "pairs_iou.csv"):
        state = open_dataset(dataset, PipelineParams(), used=params)
        state = with_pair(state, query_id=query_id, database_id=database_id)
        result = register_pair(*state.pair, params, memo)
        if result.registration.T_database_query is None:
            continue
        for look, options in LOOKS.items():
            scene.show(replace(state, options=options), result)
            seen[look].append(differences(server, true_motion(state)))
        angles.append(float(np.median(directions(server))))
    return seen, angles


def true_pairs(dataset: Dataset, table: Path) -> list[tuple[str, str]]:
    """Choose (query, database) among the pairs that share much ground, neighbours left out."""
    with table.open(newline="") as rows:
        shared = [
            (int(row["j"]), int(row["i"]))
            for row in csv.DictReader(rows)
            if float(row["iou_aabb"]) > 0.3 and int(row["j"]) - int(row["i"]) > 1
        ]
    chosen = shared[:: max(1, len(shared) // PAIRS)][:PAIRS]
    return [(dataset.submaps[query].id, dataset.submaps[database].id) for query, database in chosen]


def true_motion(state: ViewState) -> SE2:
    """Give the true motion from the query's frame into the database's."""
    poses = state.query.pose_true, state.database.pose_true
    assert poses[0] is not None
    assert poses[1] is not None
    return poses[1].planar.inverse() @ poses[0].planar


def differences(server: viser.ViserServer, motion: SE2) -> np.ndarray:
    """Compare the colours that the same place has on both submaps."""
    query, database = (node(server, f"/pair/{role}/surface") for role in ("query", "database"))
    tree = cKDTree(database.points[:, :2])
    near, index = tree.query(motion.apply(query.points[:, :2].astype(float)))
    same = near < query.point_size / 2
    assert same.sum() > 500
    return ciede2000(lab_of(query.colors[same]), lab_of(database.colors[index[same]]))


def directions(server: viser.ViserServer) -> np.ndarray:
    """Measure by what angles lines of inliers deviate from their mean direction [degrees]."""
    arcs = node(server, "/pair/matches/inliers").points.reshape(-1, ARC_PIECES, 2, 3)
    along = (arcs[:, -1, 1, :2] - arcs[:, 0, 0, :2]).astype(float)
    turns = along[:, 0] + 1j * along[:, 1]
    mean = np.mean(turns / np.abs(turns))
    return np.abs(np.degrees(np.angle(turns * np.conj(mean))))
