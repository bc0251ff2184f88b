"""Find all loop closures of a dataset, and write them as ``gpgrad detect`` does."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import gpgrad_core as gg

dataset = gg.load_dataset(gg.demo_path())  # or the path of your own folder
for note in dataset.notes:
    print(note)  # what loading left out or repaired
dataset = replace(dataset, submaps=dataset.submaps[1:9])  # fewer submaps: a quicker example

# Your own defaults first, then what the dataset itself asks for in its dataset.toml.
params = gg.PipelineParams(map=gg.MapParams(resolution=0.05))
params = gg.preferred_parameters(dataset, params)

with ThreadPoolExecutor(2) as executor:
    result = gg.detect_loop_closures(dataset, params, executor=executor)
accepted = [closure for closure in result.closures if closure.accepted]
print(f"{len(accepted)} of {len(result.closures)} pairs are loop closures")
for closure in sorted(accepted, key=lambda one: -one.registration.score):
    registration = closure.registration
    print(
        f"{closure.query_id} closes a loop with {closure.database_id}: "
        f"score {registration.score:.1f}, {registration.num_inliers} inliers"
    )

gg.write_closures("closures.json", gg.report_closures(dataset, result, params))
report = gg.read_closures("closures.json")
print(f"closures.json holds {len(report.pairs)} pairs")
