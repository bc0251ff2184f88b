"""``gpgrad reproduce``: the paper's figures from any datasets."""

import shlex
from collections.abc import Iterator
from dataclasses import dataclass
from math import comb
from pathlib import Path
from typing import Annotated, Any, cast

import tyro
from typing_extensions import Doc

from app.cli.flags import Given
from app.cli.inputs import (
    Comparing,
    SeedFlag,
    load,
    tell_damaged,
)
from app.cli.terminal import conclude, progress_bar, warn
from gpgrad_core.errors import InputError
from gpgrad_core.evaluation import EvaluationParams, Protocol, check_directory
from gpgrad_core.evaluation.experiment import TITLES, FigureData, check_method, study
from gpgrad_core.evaluation.report import as_in_paper
from gpgrad_core.io.records.files import check_apart
from gpgrad_core.methods import METHODS, Method, find_method
from gpgrad_core.params import SEEDS, flag_of
from gpgrad_core.run import part
from gpgrad_core.run.folders import whole_folder
from gpgrad_core.run.parallel import workers
from gpgrad_core.run.threads import num_workers

COMPARED = ("paper", "shot", "cshot", "gradient")
"""Methods of Fig. 8 unless others are named: the paper's, and gpgrad's default."""
FIGURES = ("figure_*.png", "figure_*.svg")
PAGE = "index.html"
OF_PAIRS = 0.8
"""Share of the progress that finding the loop closures takes up."""


@dataclass(frozen=True)
class Reproduce(Comparing):
    """Arguments of ``gpgrad reproduce``."""

    datasets: Annotated[
        tyro.conf.Positional[tuple[Path, ...]],
        Doc("Dataset folders. Those without true poses have no Figs. 8 and 9."),
        tyro.conf.arg(metavar="DATASET [DATASET ...]"),
    ]
    out: Annotated[
        Path,
        Doc("Folder to write index.html and the figures to. Other files in it stay."),
        tyro.conf.arg(metavar="FOLDER"),
    ]
    figure: Annotated[
        tuple[int, ...],
        Doc(f"Numbers of the figures to make: {', '.join(map(str, TITLES))}."),
        tyro.conf.arg(metavar="N [N ...]", help_behavior_hint="(default: all)"),
    ] = ()
    method: Annotated[
        tuple[str, ...],
        Doc(
            f"Methods of Fig. 8: {', '.join(METHODS)}. All other figures are of the first one, "
            "which must have gradient maps."
        ),
        tyro.conf.arg(
            metavar="NAME [NAME ...]", help_behavior_hint=f"(default: {' '.join(COMPARED)})"
        ),
    ] = ()
    seed: SeedFlag = None
    protocol: Annotated[
        Protocol,
        Doc(
            "paper: judge as in the paper's Sec. VII, which leaves no pair out. gpgrad: leave out "
            "neighbours, and pairs that touch without being true."
        ),
    ] = "gpgrad"
    evaluation: Annotated[Given[EvaluationParams], tyro.conf.arg(name="")] = Given(EvaluationParams)

    def run(self) -> None:
        numbers, methods = self._check()
        self._check_out()
        store = self.store()
        datasets = [load(path) for path in self.datasets]
        asked = [self.asked(dataset, self.seed) for dataset in datasets]
        judging = EvaluationParams()
        judging = self.evaluation.over(
            as_in_paper(judging) if self.protocol == "paper" else judging
        )
        sizes = [comb(len(dataset.submaps), 2) + 1 for dataset in datasets]
        subjects: list[FigureData] = []
        with whole_folder(self.out, earlier=self._earlier()) as folder:
            self._check_out()  # another process may just have ended
            num_jobs = sum(sizes) * len(methods)
            with progress_bar("reproduce") as progress:
                with workers(num_workers(), num_jobs) as executor:
                    for k, (dataset, params) in enumerate(zip(datasets, asked, strict=True)):
                        low, high = (OF_PAIRS * sum(sizes[:end]) / sum(sizes) for end in (k, k + 1))
                        subjects.append(
                            study(
                                dataset,
                                methods,
                                params,
                                judging,
                                numbers,
                                store=store,
                                executor=executor,
                                progress=part(progress, low, high),
                            )
                        )
                tell_damaged(store)
                # Imported here because Matplotlib takes half a second to load.
                from gpgrad_core.evaluation.plots.paper import write_figures  # noqa: PLC0415

                drawing = part(progress, OF_PAIRS, 1.0)
                notes = write_figures(folder, subjects, numbers, self.command, drawing)
        warn(*notes)
        conclude(str(self.out / PAGE), output=self.out / PAGE)

    def command(self, numbers: frozenset[int]) -> str:
        words = ["gpgrad", "reproduce", *map(str, self.datasets), "--out", str(self.out)]
        if numbers != frozenset(TITLES):
            words += ["--figure", *map(str, sorted(numbers))]
        if self.method:
            words += ["--method", *self.method]
        if self.seed is not None:
            words += ["--seed", str(self.seed)]
        if self.protocol != "gpgrad":
            words += ["--protocol", self.protocol]
        if self.params is not None:
            words += ["--params", str(self.params)]
        return shlex.join([*words, *_words(self.evaluation), *_words(self.pipeline)])

    def _check(self) -> tuple[frozenset[int], list[Method]]:
        if self.seed is not None:
            SEEDS.check("--seed", self.seed)
        for number in self.figure:
            if number not in TITLES:
                numbers = ", ".join(map(str, TITLES))
                raise InputError(f"--figure {number}: there is no such figure; known: {numbers}")
        if not self.datasets:
            raise InputError("missing: DATASET; name at least one dataset")
        places = [path.resolve() for path in self.datasets]
        for path in self.datasets:
            if places.count(path.resolve()) > 1:
                raise InputError(f"{path}: is given twice; give it once")
        names = self.method or COMPARED
        for name in names:
            if names.count(name) > 1:
                raise InputError(f"method {name!r} is given twice; give it once")
        methods = [find_method(name) for name in names]
        check_method(methods[0])
        return frozenset(self.figure or TITLES), methods

    def _check_out(self) -> None:
        check_directory(self.out, (PAGE, *FIGURES), overwrite=self.overwrite)
        check_apart([self.out / PAGE], [*self.datasets, self.params])

    def _earlier(self) -> tuple[str, ...]:
        """List what an earlier run has written; the page comes last."""
        drawn = (path.name for pattern in FIGURES for path in self.out.glob(pattern))
        return (*sorted(drawn), PAGE)


def _words(given: Given[Any], group: str = "") -> Iterator[str]:
    for name, value in given.values.items():
        if isinstance(value, Given):
            yield from _words(cast("Given[Any]", value), f"{group}{name}.")
        else:
            yield from flag_of(f"{group}{name}", value)
