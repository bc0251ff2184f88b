"""The steps of a story, and what moves between them: shown by pages, films and slides alike."""

from dataclasses import replace
from math import degrees
from typing import Literal, TypeAlias

from app.viewer.features.pair import headline_of
from app.viewer.session.keyframes import Keyframe
from app.viewer.session.layers import COMPARED
from app.viewer.session.state import ViewOptions, ViewState
from gpgrad_core.detection import PairResult
from gpgrad_core.detection.verdict import describe_length
from gpgrad_core.errors import count

Motion: TypeAlias = Literal["flight", "fade", "turn"]
"""The query flies onto the database, colours change, or the camera alone moves."""
MOTION_SECONDS: dict[Motion, float] = {"flight": 4.0, "fade": 1.6, "turn": 1.2}
STILL, LANDED = 4.5, 2.0
"""How long a step stands, and one after which the query stays where it came [s]."""


def motion_between(before: ViewOptions, after: ViewOptions) -> Motion:
    """What moves from one step to the next."""
    if after.layout != "registered":
        return "turn"
    if before.layout != "registered":
        return "flight"
    is_hidden = not (before.surfaces and after.surfaces)
    return "turn" if before.layer == after.layer or is_hidden else "fade"


def story_of(state: ViewState, result: PairResult, *, closes_map: bool) -> tuple[Keyframe, ...]:
    """A closure in five steps, and in a sixth the map that closes."""
    registration, options = result.registration, state.options
    plain = replace(
        options,
        layer="gradient" if options.layer in COMPARED else options.layer,
        layout="side by side",
        compare="both",
        keypoints=False,
        other_keypoints=False,
        inlier_lines=False,
        outlier_lines=False,
        all_lines=False,
    )
    marked = replace(plain, keypoints=True, other_keypoints=True)
    joined = replace(plain, keypoints=True, inlier_lines=True)
    counts = [len(some) for some in result.features]
    verdict, motion = headline_of(result), registration.T_database_query
    agree = f"{registration.num_inliers} of {len(result.matches)} associations agree on one motion"
    steps = [
        Keyframe(
            "The same place?",
            f"Submaps {state.query_id} and {state.database_id} of {state.dataset.name}",
            plain,
        ),
        Keyframe(
            "Keypoints of the gradient",
            f"{counts[0]:,} and {counts[1]:,} places that can be told apart from others",
            marked,
        ),
        Keyframe("Lines join what looks alike", agree, joined),
    ]
    if motion is None:
        last = replace(steps[-1], title=verdict, line="No motion explains both submaps")
        return (*steps[:2], last)
    offset = f"{motion.x:+z.2f} m, {motion.y:+z.2f} m, turned by {degrees(motion.yaw):+z.1f}°"
    left = "White is ground where noise explains the difference of the heights"
    if registration.agreement is not None:
        differ = describe_length(registration.agreement.difference)
        left = f"Heights differ by {differ}. White is what noise explains."
    steps += [
        Keyframe("The query flies in", offset, replace(joined, layout="registered")),
        Keyframe(
            verdict,
            left,
            replace(plain, layout="registered", layer="difference", beyond_noise=True),
        ),
    ]
    if closes_map:
        submaps = count(len(state.dataset.submaps), "submap")
        line = f"{submaps}, from odometry to the corrected poses"
        steps.append(Keyframe("The map closes", line, plain, subject="world"))
    return tuple(steps)
