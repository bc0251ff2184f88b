"""A drive to look at without any data: a simulated rover, whose submaps come one by one."""

import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

from app.viewer.session.session_file import Opened
from gpgrad_core.detection import MapDetector, PipelineParams, resolve_parameters
from gpgrad_core.run import Progress
from gpgrad_core.run.memo import Memo
from gpgrad_core.run.threads import num_workers
from gpgrad_core.simulation.demo import loop_params
from gpgrad_core.simulation.simulate import describe_simulated, drive_over, make_world
from gpgrad_core.slam import Drive
from gpgrad_core.types import Submap


def begin_drive(
    seed: int,
    memo: Memo,
    stage: Callable[[str], Progress],
    show: Callable[[Submap], None] = lambda _: None,
) -> Opened:
    """Begin a drive, whose submaps come from a thread of its own; shows the first."""
    told = stage("Making the ground")
    told(0.0)
    world = make_world(loop_params(seed))
    told = stage("Looking at the first of it")
    told(0.0)
    submaps = drive_over(world)
    first = next(submaps)
    show(first)
    params = PipelineParams()
    used = resolve_parameters([first], params, memo, told)
    executor = ThreadPoolExecutor(num_workers(), thread_name_prefix="drive")
    drive = Drive(
        used, detector=MapDetector(used, memo), executor=executor, name="a simulated drive"
    )
    drive.add(first)
    thread = threading.Thread(
        target=_drive_on, args=(drive, submaps, executor), name="simulated drive", daemon=True
    )
    thread.start()
    dataset = replace(describe_simulated(world.params), name=drive.settings.name, submaps=(first,))
    return Opened(dataset, params, "", None, used, drive)


def _drive_on(drive: Drive, submaps: Iterator[Submap], executor: ThreadPoolExecutor) -> None:
    with executor:
        for submap in submaps:
            drive.add(submap)
    drive.finish()
