"""Use a detector of your own: anything that registers a query to a database submap."""

from dataclasses import dataclass, field, replace

import numpy as np

import gpgrad_core as gg


@dataclass(frozen=True)
class PhaseDetector:
    """Finds the shift between two elevation maps by their Fourier transforms, without a turn."""

    params: gg.MapParams
    memo: gg.Memo = field(default_factory=gg.Memo)  # each map is made once

    def __call__(self, query: gg.Submap, database: gg.Submap) -> gg.Registration:
        """Register the query to the database: the protocol `gg.LoopDetector`."""
        maps = [self.memo(gg.infer_gradient_map, one, self.params) for one in (query, database)]
        shape = np.max([one.grid.shape for one in maps], axis=0) * 2
        images = [np.fft.fft2(one.gradient * one.trusted(0.3), tuple(shape)) for one in maps]
        product = images[1] * np.conj(images[0])
        agreement = np.fft.ifft2(product / (np.abs(product) + 1e-9)).real
        row, column = np.unravel_index(np.argmax(agreement), agreement.shape)
        peak = np.array([row, column])
        cells = np.where(peak > shape // 2, peak - shape, peak)  # the far half is negative
        shift = self.params.resolution * cells[::-1]
        offset = np.array(maps[1].grid.origin) - np.array(maps[0].grid.origin) + shift
        return gg.Registration(
            T_database_query=gg.SE2(float(offset[0]), float(offset[1]), 0.0),
            inliers=np.zeros(0, bool),
            dissimilarity=float("inf"),
            overlap_area=0.0,
            correlation=0.0,
            score=float(agreement.max() / agreement.std()),  # higher: more likely a closure
        )


dataset = gg.load_dataset(gg.demo_path())
dataset = replace(dataset, submaps=dataset.submaps[2:8])
mine = gg.detect_loop_closures(
    dataset,
    gg.PipelineParams(closure=gg.ClosureParams(min_score=20.0)),
    detector=PhaseDetector(gg.MapParams(length_scale=0.3, noise_std=0.05, resolution=0.08)),
)
ours = gg.detect_loop_closures(dataset, gg.PipelineParams(map=gg.MapParams(resolution=0.08)))

evaluation = gg.evaluate(dataset, {"phase": mine, "gradient": ours}, gg.EvaluationParams())
for method in evaluation.methods:
    ranked = method.rules[0].ranked
    print(f"{method.name}: AP {ranked.average_precision.value if ranked else float('nan'):.2f}")
