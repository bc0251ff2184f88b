"""Libraries that are loaded only when they are needed, and what to install if one is missing.

Those of the extras may not be installed. Others take seconds to load, or need shared libraries of
the system that are not in their wheels.
"""

import importlib
import re
from types import ModuleType

from gpgrad_core.errors import InputError, message_of

DEBIAN_PACKAGES = {
    "libusb-1.0.so.0": "libusb-1.0-0",
    "libEGL.so.1": "libegl1",
    "libGL.so.1": "libgl1",
    "libgomp.so.1": "libgomp1",
    "libX11.so.6": "libx11-6",
}
"""Shared libraries that Open3D's wheel expects of the system, and the Debian package of each."""


def load_library(name: str, install: str = "gpgrad") -> ModuleType:
    """Import a library; if it is missing, an InputError says how to `install` it."""
    try:
        return importlib.import_module(name)
    except ModuleNotFoundError as error:
        package = name.split(".", maxsplit=1)[0]
        if error.name is None or error.name.split(".")[0] != package:
            raise InputError(f"{package} cannot be loaded: {message_of(error)}") from error
        raise InputError(f"{package} is not installed: pip install '{install}'") from error
    except ImportError as error:
        raise InputError(f"{name} cannot be loaded: {_remedy(error)}") from error


def _remedy(error: ImportError) -> str:
    missing = re.match(r"(\S+\.so\S*): cannot open shared object file", str(error))
    if missing is None:
        return message_of(error)
    library = missing[1]
    package = DEBIAN_PACKAGES.get(library)
    if package is None:
        return f"the system library {library} is missing; install the package that holds it"
    return f"the system library {library} is missing; on Debian: apt-get install {package}"
