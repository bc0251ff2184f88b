"""Close loops while the robot drives: submaps arrive one by one."""

from dataclasses import replace

import gpgrad_core as gg

dataset = gg.load_dataset(gg.demo_path())
dataset = replace(dataset, submaps=dataset.submaps[1:9])  # fewer submaps: a quicker example
params = gg.PipelineParams(map=gg.MapParams(resolution=0.05))

# ``search_radius`` compares a new submap only with those near it by the present estimate.
with gg.LoopCloser(params, search_radius=25.0) as closer:
    for submap in dataset.submaps:  # in your program: as your mapping system makes them
        step = closer.add(submap)
        found = [closure.database_id for closure in step.accepted]
        place = step.poses[submap.id].translation
        print(
            f"{submap.id} at ({place[0]:.2f}, {place[1]:.2f}) m closes loops with {found or 'none'}"
        )

# The last step's poses are those of the whole traverse, corrected.
truth = {one.id: one.pose_true for one in dataset.submaps if one.pose_true is not None}
drifted = {one.id: one.pose_odometry for one in dataset.submaps if one.pose_odometry is not None}
before = gg.trajectory_error(truth, drifted).absolute
after = gg.trajectory_error(truth, step.poses).absolute
print(f"trajectory error: {before:.3f} m before, {after:.3f} m after")
