"""The methods of loop-closure detection, by name: the pipeline and what it is compared with."""

import importlib.util
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Literal

from gpgrad_core.detection import MapDetector, PipelineParams, check_searchable, resolve_parameters
from gpgrad_core.detection.shortlist import Candidates
from gpgrad_core.errors import InputError
from gpgrad_core.libraries import load_library
from gpgrad_core.methods.appearance import appearance_detector
from gpgrad_core.methods.paper import PaperDetector, paper_params
from gpgrad_core.methods.peers import (
    fgr_detector,
    fpfh_detector,
    kiss_matcher_detector,
    map_closures_detector,
)
from gpgrad_core.methods.rivals import chance_detector, judged_by_inliers
from gpgrad_core.methods.scan_context import judged_by_context, scan_context_detector
from gpgrad_core.methods.shot import cshot_detector, shot_detector
from gpgrad_core.methods.smoothed import elevation_detector, elevation_params, smoothed_detector
from gpgrad_core.run.memo import Memo
from gpgrad_core.run.progress import Progress, silent
from gpgrad_core.types import LoopDetector, Submap

__all__ = ["METHODS", "Method", "find_method"]
Automatic = Literal["dataset", "submap", "guess"]
"""Source of automatic parameters: a fit to the dataset, to each submap, or a first guess."""


def _as_given(params: PipelineParams) -> PipelineParams:
    return params


@dataclass(frozen=True, eq=False)
class Method:
    """A method of loop-closure detection."""

    name: str  # its name, as in ``--method``
    summary: str  # what it does, in one line
    # makes its detector, which keeps the results of each submap in the memo
    detector: Callable[[PipelineParams, Memo], LoopDetector]
    # turns the given parameters into those with which the method runs
    adapt: Callable[[PipelineParams], PipelineParams] = _as_given
    automatic: Automatic = "guess"  # what gives automatic parameters their numbers
    # a module that it needs and that may be missing, because it belongs to an extra or needs a
    # shared library of the system
    package: str = ""
    install: str = "gpgrad"  # the argument of ``pip install`` that brings the package

    def settle(
        self,
        submaps: Sequence[Submap],
        params: PipelineParams,
        memo: Memo | None = None,
        progress: Progress = silent,
    ) -> PipelineParams:
        """Fit automatic parameters to the submaps as the method needs; InputError if it cannot.

        The memo keeps the fits.
        """
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
        """Whether the package that it needs is installed."""
        return not self.package or importlib.util.find_spec(self.package) is not None


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
            elevation_detector,
            elevation_params,
            automatic="dataset",
        ),
        Method("smoothed", "The same, on a blurred grid of mean heights.", smoothed_detector),
        Method("fpfh", "FPFH and RANSAC.", fpfh_detector, judged_by_inliers, package="open3d"),
        Method(
            "fgr",
            "FPFH and fast global registration.",
            fgr_detector,
            judged_by_inliers,
            package="open3d",
        ),
        Method(
            "shot",
            "SHOT on curved keypoints, RANSAC.",
            shot_detector,
            judged_by_inliers,
            package="open3d",
        ),
        Method(
            "cshot",
            "SHOT with colours, RANSAC.",
            cshot_detector,
            judged_by_inliers,
            package="open3d",
        ),
        Method(
            "scan-context",
            "Scan Context and ICP.",
            scan_context_detector,
            judged_by_context,
            package="open3d",
        ),
        Method(
            "appearance",
            "ORB and a bag of words, on the dataset's images.",
            appearance_detector,
            judged_by_inliers,
        ),
        Method(
            "kiss-matcher",
            "KISS-Matcher, of the extra 'peers'.",
            kiss_matcher_detector,
            judged_by_inliers,
            package="kiss_matcher",
            install="gpgrad[peers]",
        ),
        Method(
            "map-closures",
            "MapClosures, of the extra 'peers'.",
            map_closures_detector,
            judged_by_inliers,
            package="map_closures",
            install="gpgrad[peers]",
        ),
        Method("chance", "A score at random.", chance_detector, judged_by_inliers),
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
