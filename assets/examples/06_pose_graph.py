"""Correct a drifted traverse by its loop closures."""

from dataclasses import replace

import gpgrad_core as gg

dataset = gg.load_dataset(gg.demo_path())  # its poses_odom.txt is the drifted estimate
dataset = replace(dataset, submaps=dataset.submaps[1:9])  # fewer submaps: a quicker example
params = gg.PipelineParams(map=gg.MapParams(resolution=0.05))
closures = gg.detect_loop_closures(dataset, params).closures

# Submaps are the nodes. Odometry and the accepted closures are the edges.
graph = gg.build_pose_graph(dataset, closures, gg.GraphParams())
print(f"{len(graph.poses)} submaps, {len(graph.loops)} loop closures")

# The solver refuses closures that all the others contradict: their weight becomes 0.
optimised = gg.optimise_pose_graph(graph, gg.SolverParams())
refused = [fit.edge for fit in optimised.edges if fit.edge.kind == "loop" and fit.weight < 0.5]
print(f"{len(refused)} closures refused as wrong")

# The true poses tell how much it helped. They took no part in the work.
truth = {one.id: one.pose_true for one in dataset.submaps if one.pose_true is not None}
before = gg.trajectory_error(truth, graph.poses)
after = gg.trajectory_error(truth, optimised.poses)
print(f"trajectory error: {before.absolute:.3f} m before, {after.absolute:.3f} m after")

gg.write_graph("graph.g2o", graph, optimised.poses)
print("wrote graph.g2o")
