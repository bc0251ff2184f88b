"""The methods of loop-closure detection, by name: the pipeline and what it is compared with."""

import importlib.util
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Literal, TypeVar

from gpgrad_core.detection import MapDetector, PipelineParams, check_searchable, resolve_parameters
from gpgrad_core.detection.shortlist import Candidates
from gpgrad_core.errors import InputError
from gpgrad_core.libraries import load_library
from gpgrad_core.methods.appearance import AppearanceDetector
from gpgrad_core.methods.paper import PaperDetector, paper_params
from gpgrad_core.methods.peers import (
    describe_fpfh,
    register_by_fgr,
    register_by_kiss_matcher,
    register_by_map_closures,
)
from gpgrad_core.methods.rivals import (
    CloudDetector,
    guess,
    judged_by_inliers,
    register_by_ransac,
    whole_submap,
)
from gpgrad_core.methods.scan_context import (
    describe_contexts,
    judged_by_context,
    register_by_context,
)
from gpgrad_core.methods.shot import describe_cshot, describe_shot
from gpgrad_core.methods.smoothed import elevation_as_image, elevation_params, memoised_smoothed_map
from gpgrad_core.run import Progress, silent
from gpgrad_core.run.memo import Memo
from gpgrad_core.types import LoopDetector, Registration, Submap

__all__ = ["METHODS", "Method", "find_method"]
D = TypeVar("D")
Automatic = Literal["dataset", "submap", "guess"]
"""Source of automatic parameters: a fit to the dataset, to each submap, or a first guess."""


@dataclass(frozen=True, eq=False)
class Method:
    """A method of loop-closure detection."""

    name: str  # its name, as in ``--method``
    summary: str  # what it does, in one line
    # makes its detector, which keeps the results of each submap in the memo
    detector: Callable[[PipelineParams, Memo], LoopDetector]
    # turns the given parameters into those with which the method runs
    adapt: Callable[[PipelineParams], PipelineParams] = lambda params: params
    automatic: Automatic = "guess"  # what gives automatic parameters their numbers
    # a module that it needs and that may be missing, because it belongs to an extra or needs a
    # shared library of the system
    package: str = ""
    install: str = "gpgrad"  # the argument of ``pip install`` that brings the package

    def resolve(
        self,
        submaps: Sequence[Submap],
        params: PipelineParams,
        memo: Memo | None = None,
        progress: Progress = silent,
    ) -> PipelineParams:
        """Fit automatic parameters to the submaps as the method needs; InputError if it cannot."""
        if self.fitted and submaps:
            params = resolve_parameters(submaps, params, memo, progress)
        return self.ready(params)

    @property
    def fitted(self) -> bool:
        """Whether automatic parameters are fitted to the dataset."""
        return self.automatic == "dataset"

    def ready(self, params: PipelineParams) -> PipelineParams:
        """Turn parameters that are fitted, where they are to be, into those that it runs with."""
        if self.automatic == "guess":
            params = replace(params, map=params.map.guessed)
        return self.adapt(params)

    def check_searchable(self, candidates: Candidates) -> None:
        """Raise InputError if the method has no keypoints to choose so many candidates by."""
        try:
            check_searchable(candidates, self.detector(self.ready(PipelineParams()), Memo()))
        except InputError as error:
            raise InputError(f"method {self.name}: {error}") from None

    @property
    def installed(self) -> bool:
        return not self.package or importlib.util.find_spec(self.package) is not None


def _rival(
    name: str,
    summary: str,
    describe: Callable[[Submap, PipelineParams], D],
    register: Callable[[D, D, PipelineParams], Registration],
    package: str = "",
    install: str = "gpgrad",
) -> Method:
    """Make a method of two functions that is judged by its number of inliers."""
    detector = partial(CloudDetector[D], describe, register)
    return Method(name, summary, detector, judged_by_inliers, package=package, install=install)


METHODS: dict[str, Method] = {
    method.name: method
    for method in (
        Method(
            "gradient",
            "Keypoints on Gaussian-process gradient maps.",
            MapDetector,
            automatic="dataset",
        ),
        Method(
            "paper", "The paper to the letter.", PaperDetector, paper_params, automatic="submap"
        ),
        Method(
            "elevation",
            "The same, keypoints on the elevation image.",
            partial(MapDetector, drawn_from=elevation_as_image),
            elevation_params,
            automatic="dataset",
        ),
        Method(
            "smoothed",
            "The same, on a blurred grid of mean heights.",
            partial(MapDetector, make_map=memoised_smoothed_map),
        ),
        _rival("fpfh", "FPFH and RANSAC.", describe_fpfh, register_by_ransac, "open3d"),
        _rival(
            "fgr", "FPFH and fast global registration.", describe_fpfh, register_by_fgr, "open3d"
        ),
        _rival(
            "shot", "SHOT on curved keypoints, RANSAC.", describe_shot, register_by_ransac, "open3d"
        ),
        _rival("cshot", "SHOT with colours, RANSAC.", describe_cshot, register_by_ransac, "open3d"),
        Method(
            "scan-context",
            "Scan Context and ICP.",
            partial(CloudDetector, describe_contexts, register_by_context),
            judged_by_context,
            package="open3d",
        ),
        Method(
            "appearance",
            "ORB and a bag of words, on the dataset's images.",
            AppearanceDetector,
            judged_by_inliers,
        ),
        _rival(
            "kiss-matcher",
            "KISS-Matcher, of the extra 'peers'.",
            whole_submap,
            register_by_kiss_matcher,
            "kiss_matcher",
            "gpgrad[peers]",
        ),
        _rival(
            "map-closures",
            "MapClosures, of the extra 'peers'.",
            whole_submap,
            register_by_map_closures,
            "map_closures",
            "gpgrad[peers]",
        ),
        _rival("chance", "A score at random.", whole_submap, guess),
    )
}
"""Every method by its name."""


def find_method(name: str) -> Method:
    """Find a method by name; InputError if there is none, or its package is not installed."""
    method = METHODS.get(name)
    if method is None:
        raise InputError(f"unknown --method {name!r}; known: {', '.join(METHODS)}")
    if method.package:
        try:
            load_library(method.package, method.install)
        except InputError as error:
            raise InputError(f"--method {name}: {error}") from None
    return method
