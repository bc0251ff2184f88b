"""Compare two submaps stage by stage: from their maps to the verdict."""

import math

import gpgrad_core as gg

dataset = gg.load_dataset(gg.demo_path())
query, database = dataset.submap("007"), dataset.submap("001")
# What is automatic is fitted to both, so that both maps are made alike.
asked = gg.PipelineParams(map=gg.MapParams(resolution=0.05))
params = gg.resolve_parameters((query, database), asked)

# Each stage is a pure function of its data and of its own frozen parameters.
query_map = gg.infer_gradient_map(query, params.map)
database_map = gg.infer_gradient_map(database, params.map)
query_features = gg.extract_features(query_map, params.features)
database_features = gg.extract_features(database_map, params.features)
print(f"{len(query_features)} and {len(database_features)} keypoints")

associations = gg.match_features(query_features, database_features, params.matching)
print(f"{len(associations)} associations")

registration = gg.register(query_map, database_map, associations, params.registration)
closure = gg.classify(registration, params.closure, query_id=query.id, database_id=database.id)
verdict = "loop closure" if closure.accepted else "not a loop closure"
print(f"{verdict}: {registration.num_inliers} inliers, {closure.reason}")

# The motion maps points of the query's frame into the database's frame.
motion = registration.T_database_query
if motion is not None:
    offset = math.hypot(motion.x, motion.y)
    print(f"turn {math.degrees(motion.yaw):.1f} degrees, offset {offset:.2f} m")
    print(f"the query's origin lies at {motion.apply([[0.0, 0.0]])[0]} in the database's frame")
