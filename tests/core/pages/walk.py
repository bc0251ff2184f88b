"""A small traverse with closures, and its page, read back without a browser."""

import base64
import json
import re
import zlib
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from gpgrad_core.detection import DetectionResult, PipelineParams
from gpgrad_core.io.records.closures import report_closures
from gpgrad_core.mapping.gradient_map import MapParams
from gpgrad_core.pages import PageData, subject_of
from gpgrad_core.se2 import SE2
from gpgrad_core.types import Dataset, LoopClosure
from tests.core.slam.simulated import closure
from tests.core.slam.test_solution import FOUND, WALK

PARAMS = PipelineParams(
    map=MapParams(length_scale=0.2, noise_std=0.02, signal_std=0.2, scale=0.2, resolution=0.1)
)


def walk() -> tuple[Dataset, list[LoopClosure]]:
    first, second = WALK.submaps[:2]
    unknown = closure(second.id, first.id, SE2(), 0.0)
    unlike = replace(unknown.registration, T_database_query=None, covariance=None, score=0.4)
    return WALK, [replace(unknown, registration=unlike, accepted=False), *FOUND]


def subject(**options: Any) -> PageData:
    dataset, closures = walk()
    report = report_closures(dataset, DetectionResult(tuple(closures), {}), PARAMS)
    return subject_of(dataset, report, PARAMS, **options)


@dataclass(frozen=True, eq=False)
class Read:
    content: dict[str, Any]
    arrays: dict[str, list[np.ndarray]]


def read_page(page: str) -> Read:
    """Unpack a page as its script does."""

    def inside(kind: str) -> str:
        found = re.search(rf'<script type="{kind}" id="\w+">(.*?)</script>', page, re.DOTALL)
        assert found is not None
        return found[1]

    content = json.loads(inside("application/json"))
    raw, start = zlib.decompress(base64.b64decode(inside("text/plain"))), 0
    arrays: dict[str, list[np.ndarray]] = {}
    for name, kind, length in content["arrays"]:
        array = np.frombuffer(raw[start : start + length], np.dtype(kind).newbyteorder("<"))
        arrays.setdefault(name, []).append(array)
        start += length + -length % 4
    assert start == len(raw)
    return Read(content, arrays)
