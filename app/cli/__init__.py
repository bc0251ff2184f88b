"""The command line: a module for each verb, with a dataclass whose fields are its arguments.

A verb's module is imported when the verb is to run, and no other: each brings libraries that
take a while to load.
"""

from collections.abc import Callable, Sequence
from importlib import import_module
from pathlib import Path
from typing import Protocol, cast

import tyro

from app.cli.flags import JSON, one_line_usage, parse
from app.cli.terminal import EVENTS, FAILED, Started, exit_code, say
from app.ending import INTERRUPTED
from gpgrad_core import __version__
from gpgrad_core.errors import InputError

__all__ = ["FAILED", "INTERRUPTED", "VERBS", "run"]

DESCRIPTION = (
    "Find loop closures on bare terrain by Gaussian-process gradient maps.\n\n"
    "Run gpgrad VERB --help for the arguments of a verb, and gpgrad --version for the version."
)
VERBS: dict[str, str] = {
    "view": "Open the viewer in a browser, and explore a dataset live.",
    "demo": (
        "Watch a simulated rover drive, live in the viewer, and close its loop. It needs no data."
    ),
    "detect": (
        "Register every pair of submaps of a dataset, and accept or refuse each as a loop closure."
    ),
    "evaluate": "Evaluate methods by the true poses: precision, recall, pose errors and figures.",
    "reproduce": "Make the paper's figures from datasets, with one page that shows all of them.",
    "map": "Infer the elevation, its variance and both slopes of one cloud.",
    "fit": "Fit the terrain's length-scale, signal and noise by maximum marginal likelihood.",
    "build": (
        "Build submaps from scans and poses. Run the same command again to resume a stopped build."
    ),
    "slam": (
        "Correct a traverse by its loop closures, and merge its submaps into one cloud and one map."
    ),
    "locate": "Find submaps on a larger elevation model, such as one from orbit.",
    "simulate": "Simulate a dataset with known true poses.",
}

LEAST_ADDRESS_SPACE = 10**9
"""For the libraries and a small dataset [bytes]."""


class Verb(Protocol):
    """A verb's arguments."""

    def run(self) -> None:
        """Run the verb."""
        ...


def run(arguments: Sequence[str]) -> int:
    """Run one verb, from the command line without the program's name; returns its `exit_code`."""
    # Before the flags are read, so that a wrong one is an event too.
    with EVENTS.on(JSON in arguments[1:]):
        return exit_code(lambda: _run(arguments))


def _run(arguments: Sequence[str]) -> None:
    name, *rest = arguments or ("",)
    if name in VERBS and not {"-h", "--help"} & set(rest):
        EVENTS.tell(Started(name))
    if name in ("view", "demo") and not {"-h", "--help"} & set(rest):
        say("The viewer starts …")  # before its libraries are loaded, which takes a moment
    if name in VERBS:
        _check_current_folder()
        _check_address_space()
        parse(_verb(name), name, rest, VERBS[name]).run()
    elif list(arguments) == ["--version"]:
        say(__version__)
    elif name and not name.startswith("-"):
        raise InputError(f"unknown verb {name!r}; known: {', '.join(VERBS)}")
    else:
        with one_line_usage():  # prints the list of verbs, or says what is wrong
            tyro.extras.subcommand_cli_from_dict(
                {verb: _listed(summary) for verb, summary in VERBS.items()},
                prog="gpgrad",
                description=DESCRIPTION,
                args=arguments,
            )


def _check_current_folder() -> None:
    """Refuse to work where nothing is: some libraries abort there, others name no file."""
    try:
        Path.cwd()
    except OSError:
        raise InputError("the current folder is gone, or cannot be read; go to another") from None


def _check_address_space() -> None:
    """Refuse to work where BLAS would ask for a buffer again and again, and never get it."""
    try:
        resource = import_module("resource")
        allowed, _ = resource.getrlimit(resource.RLIMIT_AS)
    except (ImportError, AttributeError):  # a system without such limits
        return
    if allowed != resource.RLIM_INFINITY and allowed < LEAST_ADDRESS_SPACE:
        raise InputError(
            f"{allowed / 1e6:,.0f} MB of address space are allowed (ulimit -v), and the libraries "
            f"need {LEAST_ADDRESS_SPACE / 1e6:,.0f} MB at least; allow more"
        )


def _verb(name: str) -> type[Verb]:
    return cast("type[Verb]", getattr(import_module(f"app.cli.{name}"), name.capitalize()))


def _listed(summary: str) -> Callable[[], None]:
    def verb() -> None: ...

    verb.__doc__ = summary
    return verb
