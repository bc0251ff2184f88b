"""Change parameters, let the points choose them, and compute only what a change touches."""

import time
from dataclasses import replace

import gpgrad_core as gg

dataset = gg.load_dataset(gg.demo_path())
query, database = dataset.submap("007"), dataset.submap("001")

# Parameters are frozen: a change makes a new value, and a value out of bounds is refused.
params = gg.PipelineParams(map=gg.MapParams(length_scale=0.3, noise_std=0.05, resolution=0.05))
try:
    replace(params.map, length_scale=-1.0)
except gg.InputError as error:
    print("refused:", error)

# A memo remembers the results of every stage by the parameters of that stage.
memo = gg.Memo()


def compare(params: gg.PipelineParams, change: str) -> None:
    """Compare the pair, and say how long that took."""
    start = time.perf_counter()
    result = gg.register_pair(query, database, params, memo)
    milliseconds = 1000 * (time.perf_counter() - start)
    print(f"{change}: {result.closure.reason} ({milliseconds:.0f} ms)")


compare(params, "defaults")
compare(replace(params, closure=gg.ClosureParams(min_inliers=8)), "a stricter verdict")
compare(replace(params, map=replace(params.map, length_scale=0.45)), "a longer length-scale")
compare(params, "defaults again")

# Maximum marginal likelihood finds the length-scale and the noise from the points themselves.
found = gg.fit_parameters([query])
print(
    f"fitted: length-scale {found.params.length_scale:.2f} m, noise {found.params.noise_std:.3f} m"
)
gain = found.log_likelihood_after - found.log_likelihood_before
print(f"log likelihood per point: {gain:+.2f}")
fitted = gg.MapParams(**{**vars(found.params), "resolution": 0.05})
compare(replace(params, map=fitted), "fitted")
