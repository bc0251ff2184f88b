"""Judge a detector by the true poses: precision, recall, and a report with figures."""

from dataclasses import replace

import gpgrad_core as gg

dataset = gg.load_dataset(gg.demo_path())
dataset = replace(dataset, submaps=dataset.submaps[2:7])  # fewer submaps: a quicker example
coarse = gg.PipelineParams(map=gg.MapParams(resolution=0.06))
sift = replace(coarse, features=gg.FeatureParams(detector=gg.DetectorParams(name="sift")))

# Any number of detections of the same dataset are judged side by side.
detections = {
    "slope keypoints": gg.detect_loop_closures(dataset, coarse),
    "SIFT keypoints": gg.detect_loop_closures(dataset, sift),
}
evaluation = gg.evaluate(dataset, detections, gg.EvaluationParams())

# Two rules say which pairs are true; every figure belongs to one of them.
for method in evaluation.methods:
    for rule, verdict in zip(evaluation.rules, method.rules, strict=True):
        accepted = f"{verdict.accepted_true} right and {verdict.accepted_false} wrong"
        precision = verdict.ranked.average_precision.value if verdict.ranked else float("nan")
        print(f"{method.name}, rule {rule.name}: AP {precision:.2f}, accepts {accepted}")

files = gg.write_report("report", evaluation)
print("wrote", ", ".join(file.name for file in files))
