"""One submap to its gradient map, by itself: what is automatic is fitted to it."""

from jaxtyping import Float

from gpgrad_core.gradient_map import MapParams, fit_terrain, map_grid, sample_map
from gpgrad_core.pipeline.automatic import resolve_parameters
from gpgrad_core.pipeline.params import PipelineParams
from gpgrad_core.run.progress import Progress, part, silent
from gpgrad_core.types import Array, GradientMap, Submap


def infer_gradient_map(
    submap: Submap, params: MapParams | None = None, progress: Progress = silent
) -> GradientMap:
    """Infer elevation, variance and slopes over the submap's bounding box, Eqs. (2)-(5).

    Args:
        submap: Gravity-aligned points [m].
        params: Parameters of the GP and the grid; None takes the defaults. If length-scale or noise
            are automatic, all that is automatic is fitted to this submap, as `resolve_parameters`
            does.
        progress: Called with the fraction done; may raise Cancelled.

    Returns:
        The gradient map, with elevations in metres and slopes in m/m.

    Raises:
        InputError: If the grid or the GP would be too large, or if the GP cannot be solved.
    """
    params = params or MapParams()
    map_grid(submap, params.resolution)  # refuse a cloud that is too wide before the long work
    params, progress = _with_numbers(submap, params, progress)
    posterior = fit_terrain(submap, params.terrain, progress=progress)
    return sample_map(submap, posterior, params.resolution, params.scale)


def infer_slope_variance(
    submap: Submap, params: MapParams | None = None, progress: Progress = silent
) -> Float[Array, "rows columns 2"]:
    """Infer the variance of the slopes of `infer_gradient_map`.

    The paper does not have it. Eq. (3) is differentiated as Eqs. (4) and (5) differentiate Eq. (2),
    with D the diagonal matrix of the points' noise variances:

        var(∂z/∂x) = ∂²k/∂x∂x' - ∂K(x, X)/∂x [K(X, X) + D]⁻¹ ∂K(X, x')/∂x'

    Args:
        submap: Gravity-aligned points [m].
        params: Parameters of the GP and the grid, as in `infer_gradient_map`.
        progress: Called with the fraction done; may raise Cancelled.

    Returns:
        Posterior variance of the slope along x and along y (rows, columns, 2) [m²/m²].

    Raises:
        InputError: If the grid or the GP would be too large, or if the GP cannot be solved.
    """
    params = params or MapParams()
    grid = map_grid(submap, params.resolution)
    params, progress = _with_numbers(submap, params, progress)
    return fit_terrain(submap, params.terrain, progress=progress).sample_slope_variance(grid)


def _with_numbers(
    submap: Submap, params: MapParams, progress: Progress
) -> tuple[MapParams, Progress]:
    """Fit what is automatic to one submap; also gives the progress of what is left to do."""
    if params.length_scale is not None and params.noise_std is not None:
        return params, progress
    asked = PipelineParams(map=params)
    fitted = resolve_parameters([submap], asked, progress=part(progress, 0.0, 0.5))
    return fitted.map, part(progress, 0.5, 1.0)
