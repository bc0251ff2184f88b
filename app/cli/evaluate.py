"""``gpgrad evaluate``: judge methods by the true poses."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, ClassVar

import tyro
from typing_extensions import Doc

from app.cli.detect import tell_closure
from app.cli.flags import Given, PageFlag
from app.cli.inputs import (
    CandidatesFlag,
    Comparing,
    SeedFlag,
    load,
    tell_damaged,
)
from app.cli.terminal import conclude, progress_bar, warn, working
from gpgrad_core import evaluation as judging
from gpgrad_core.detection.shortlist import num_candidates, read_candidates
from gpgrad_core.io.records.files import check_apart
from gpgrad_core.methods import METHODS, find_method
from gpgrad_core.pages import PAGE, subject_of, write_page
from gpgrad_core.params import SEEDS
from gpgrad_core.run.folders import whole_folder
from gpgrad_core.run.memo import Memo

REPORT = (PAGE, "report.md", "report.json")
"""Files that tell an evaluation; the last one is written last."""


@dataclass(frozen=True)
class Evaluate(Comparing):
    """Arguments of ``gpgrad evaluate``."""

    typed: ClassVar[str] = ""  # the command line, which the page shows
    dataset: Annotated[
        tyro.conf.Positional[Path],
        Doc("Dataset folder with poses_gt.txt."),
        tyro.conf.arg(metavar="DATASET"),
    ]
    out: Annotated[
        Path,
        Doc("Folder to write the report, page.html and figures to. Other files in it stay."),
        tyro.conf.arg(metavar="FOLDER"),
    ]
    method: Annotated[
        tuple[str, ...],
        Doc(f"Methods to run: {', '.join(METHODS)}."),
        tyro.conf.arg(
            metavar="NAME [NAME ...]",
            help_behavior_hint="(default: gradient, or none if there are files of closures)",
        ),
    ] = ()
    closures: Annotated[
        tuple[Path, ...],
        Doc("Also evaluate the loop closures in these files, as gpgrad detect writes them."),
        tyro.conf.arg(metavar="FILE [FILE ...]", help_behavior_hint="(default: none)"),
    ] = ()
    pairs: Annotated[
        Path | None,
        Doc(
            "Compare and judge only the pairs that this file of the point clouds registration "
            "benchmark lists, such as p2at_met_global.txt, also by the benchmark's own error."
        ),
        tyro.conf.arg(metavar="FILE.txt", help_behavior_hint="(default: all pairs)"),
    ] = None
    seed: SeedFlag = None
    candidates: CandidatesFlag = "automatic"
    protocol: Annotated[
        judging.Protocol,
        Doc(
            "paper: also judge as in the paper's Sec. VII, which leaves no pair out, and set both "
            "side by side."
        ),
    ] = "gpgrad"
    calibration: Annotated[
        bool,
        Doc("Also test the maps' uncertainty on points held out. This takes about a minute."),
    ] = False
    page: PageFlag = True
    evaluation: Annotated[Given[judging.EvaluationParams], tyro.conf.arg(name="")] = Given(
        judging.EvaluationParams
    )

    def run(self) -> None:
        if self.seed is not None:
            SEEDS.check("--seed", self.seed)
        names = self.method if self.method or self.closures else ("gradient",)
        candidates = read_candidates(self.candidates)
        methods = [find_method(name) for name in names]
        for method in methods:
            method.check_searchable(candidates)
        self._check_out(names)
        rivals = judging.read_rivals(self.closures, taken=names)
        problems = () if self.pairs is None else judging.read_problems(self.pairs)
        store = self.store()
        dataset = load(self.dataset)
        params = self.asked(dataset, self.seed)
        if self.pairs is not None:
            judging.check_problems(problems, dataset, self.pairs)
        only = {(problem.source, problem.target) for problem in problems} or None
        pairs = judging.measure_pairs(dataset, only=only)
        for name, report in rivals.items():
            judging.rank_pairs(report, dataset, pairs, name)  # refuses a wrong file before the work
        num_pairs = sum(num_candidates(candidates, k) for k in range(len(dataset.submaps)))
        num_pairs = num_pairs if only is None else len(pairs)
        num_jobs = num_pairs * len(methods)
        with whole_folder(self.out, earlier=REPORT) as folder:
            self._check_out(names)  # another process may just have ended
            with working("evaluate", num_jobs) as (progress, executor):
                detected = judging.run_methods(
                    dataset,
                    methods,
                    params,
                    candidates=candidates,
                    executor=executor,
                    store=store,
                    progress=progress,
                    only=only,
                )
            tell_damaged(store)
            for name, report in detected.items():
                for closure in report.accepted:
                    tell_closure(closure, name)
            reports = detected | rivals
            evaluation = judging.evaluate(
                dataset,
                reports,
                self.evaluation.over(judging.EvaluationParams()),
                pairs=pairs,
                seed=params.registration.seed,
            )
            sections: list[judging.Section] = []
            if self.calibration:
                with progress_bar("calibration") as progress:
                    judged = judging.calibrate(
                        dataset, params, seed=params.registration.seed, progress=progress
                    )
                sections.append(judging.describe_calibration(judged))
            sections += judging.describe_images(reports, evaluation)
            if self.protocol == "paper":
                sections.append(judging.describe_protocol(dataset, reports, evaluation))
            if self.pairs is not None:
                sections.append(
                    judging.describe_problems(problems, dataset, evaluation, self.pairs)
                )
            if self.page:
                name, report = next(iter(reports.items()))  # the page is of the first method
                memo = Memo(store=store)
                if name in METHODS:
                    params = METHODS[name].resolve(dataset.submaps, params, memo)
                subject = subject_of(
                    dataset, report, params, evaluation=evaluation, commands=[self.typed]
                )
                with progress_bar("page") as progress:
                    write_page(folder / PAGE, subject, memo, progress)
            with progress_bar("figures") as progress:
                judging.write_report(
                    folder, evaluation, closures=detected, sections=sections, progress=progress
                )
        warn(*evaluation.notes)
        conclude(
            *judging.describe_evaluation(evaluation, reports),
            str(self.out / "report.md"),
            output=self.out,
            methods={method.name: method.in_numbers for method in evaluation.methods},
        )

    def _check_out(self, methods: Sequence[str]) -> None:
        judging.check_directory(self.out, REPORT, overwrite=self.overwrite)
        written = (*REPORT, *(f"closures_{name}.json" for name in methods))
        check_apart(
            [self.out / name for name in written],
            [self.dataset, *self.closures, self.pairs, self.params],
        )
