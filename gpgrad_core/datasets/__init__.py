"""Where submaps come from: cloud files, dataset folders, the built-in demo."""

from gpgrad_core.datasets.clouds import load_cloud
from gpgrad_core.datasets.demo import demo_path
from gpgrad_core.datasets.folder import load_dataset, write_dataset

__all__ = ["demo_path", "load_cloud", "load_dataset", "write_dataset"]
