"""The kinds of recordings, in the order in which a path is tried as each of them."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from gpgrad_core.recordings.bag import open_bag
from gpgrad_core.recordings.bag_reader import is_bag, is_split_bag
from gpgrad_core.recordings.cloud_folder import is_scan_folder, open_folder
from gpgrad_core.recordings.euroc import is_euroc, open_euroc
from gpgrad_core.recordings.katwijk import is_katwijk, open_katwijk
from gpgrad_core.recordings.kitti_images import is_kitti_pairs, open_kitti_pairs
from gpgrad_core.recordings.madmax import is_madmax, open_madmax
from gpgrad_core.recordings.params import BuildParams
from gpgrad_core.recordings.pds import has_products, open_products
from gpgrad_core.recordings.recording import Recording, RecordingSources


@dataclass(frozen=True)
class Kind:
    """A kind of recording."""

    fits: Callable[[Path], bool]  # whether a path is one
    open: Callable[[Path, RecordingSources, BuildParams], Recording]
    unposed: bool = False  # whether it is opened without poses where odometry is to make them


KINDS = (
    Kind(is_bag, open_bag, unposed=True),
    Kind(is_katwijk, open_katwijk),
    Kind(has_products, open_products),
    Kind(is_scan_folder, open_folder, unposed=True),
    Kind(is_madmax, open_madmax),
    Kind(is_euroc, open_euroc),
    Kind(is_kitti_pairs, open_kitti_pairs),
    Kind(is_split_bag, open_bag, unposed=True),
)
