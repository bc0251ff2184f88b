"""README, guide and the other pages tell the truth: their Python runs, what they name exists."""

import re
import subprocess
import sys
import tomllib
from functools import cache
from pathlib import Path

import pytest
import yaml

import gpgrad_core as gg
from tests.end_to_end.process import VERBS, environment, gpgrad

ROOT = Path(__file__).resolve().parents[1]
GUIDE = ROOT / "assets" / "guide"
README = (ROOT / "README.md").read_text(encoding="utf-8")
PAGES = [
    ROOT / "README.md",
    ROOT / "CHANGELOG.md",
    *sorted(GUIDE.rglob("*.md")),
    *sorted((ROOT / ".github").glob("*.md")),
    ROOT / "tests" / "long" / "README.md",
]
MOST_WORDS = 1100

every_page = pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))


def read(page: Path) -> str:
    return page.read_text(encoding="utf-8")


def blocks(page: Path, language: str) -> list[str]:
    fenced = re.findall(r"^```(\w*)\n(.*?)^```$", read(page), flags=re.MULTILINE | re.DOTALL)
    return [text for name, text in fenced if name == language]


def quoted(page: Path) -> list[str]:
    """What stands between backticks, and the lines of shell blocks."""
    prose = re.sub(r"^```.*?^```$", "", read(page), flags=re.MULTILINE | re.DOTALL)
    return re.findall(r"`([^`\n]+)`", prose) + "\n".join(blocks(page, "sh")).splitlines()


@cache
def help_of(verb: str) -> str:
    return gpgrad(verb, "--help").out


@cache
def flags_of_all() -> set[str]:
    """Every flag of the command, and of the benchmarks that pages name."""
    benchmarks = [
        (ROOT / "tests" / "long" / "benchmarks" / f"{name}.py").read_text(encoding="utf-8")
        for name in ("bench_peers", "bench_refined", "bench_traverse", "bench_whole")
    ]
    options = re.findall(r"^    (\w+): ", "\n".join(benchmarks), flags=re.MULTILINE)
    flags = {f"--{name.replace('_', '-')}" for name in options}
    for verb in VERBS:
        flags |= set(re.findall(r"--[\w.-]+", help_of(verb)))
    return flags | {"--version", "--help"}


def anchors(page: Path) -> set[str]:
    """The headings of a page, as a forge and the site name them."""
    titles = re.findall(r"^#+ (.*)$", read(page), flags=re.MULTILINE)
    return {re.sub(r"[^\w -]", "", title).strip().lower().replace(" ", "-") for title in titles}


def test_readme_is_short() -> None:
    assert len(README.split()) <= MOST_WORDS


@pytest.mark.slow
@pytest.mark.parametrize(
    ("page", "printed"),
    [
        (ROOT / "README.md", r"\d+ closes a loop with \d+: \d+ inliers, score [\d.]+\n"),
        (GUIDE / "python.md", r"\d+ inliers, score [\d.]+: True\n"),
    ],
    ids=["README.md", "python.md"],
)
def test_the_python_example_runs(page: Path, printed: str, tmp_path: Path) -> None:
    (example,) = blocks(page, "python")
    finished = subprocess.run(
        [sys.executable, "-W", "error", "-c", example],
        capture_output=True,
        text=True,
        env=environment(),
        cwd=tmp_path,
        check=False,
    )
    assert finished.returncode == 0, finished.stderr
    assert re.match(printed, finished.stdout)


def test_the_two_commands_are_one_line_each() -> None:
    start, test = [line for line in README.splitlines() if line.startswith("python3 -m venv")]
    assert start.endswith(".venv/bin/gpgrad view")
    assert test.endswith(".venv/bin/python -m pytest")
    # What continuous integration runs is this very line, in its parts, and as a whole every night.
    machine, run, nightly = (
        (ROOT / ".ci" / name).read_text(encoding="utf-8") for name in ("machine", "run", "nightly")
    )
    assert "readme_command=$(grep -m1 -E '^python3 -m venv .*pytest' README.md)" in machine
    assert 'step "${readme_command% && *}"' in run
    assert 'step "GPGRAD_THOROUGH=1 ${readme_command##* && }"' in run
    assert "&& $readme_command" in nightly
    # The guide repeats them as they are.
    for page in PAGES:
        for line in read(page).splitlines():
            assert not line.startswith("python3 -m venv") or line in (start, test), page


@every_page
def test_links_lead_somewhere(page: Path) -> None:
    links = re.findall(r"\]\(([^)]+)\)", read(page)) + re.findall(r'src="([^"]+)"', read(page))
    for link in links:
        if link.startswith("http"):
            continue
        path, _, anchor = link.partition("#")
        target = page.parent / path if path else page
        assert target.exists(), link
        assert not anchor or anchor in anchors(target), link


def test_files_named_in_the_listing_exist() -> None:
    listing = next(
        block for block in blocks(GUIDE / "architecture.md", "") if block.startswith("gpgrad_core/")
    )
    folder = ROOT
    named = 0
    for line in listing.splitlines():
        names = re.findall(
            r"[\w./]*[\w.]+(?:/|\.py)(?=\s|$)", line.split("   ")[0] if line[0] != " " else line
        )
        if not line.startswith(" "):
            folder = ROOT / names[0]
            assert folder.is_dir()
            continue
        for name in names:
            assert (folder / name).exists(), name
            named += 1
    assert named > 10


def test_the_layers_are_those_of_the_contract() -> None:
    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"]
    core = next(one for one in contracts["contracts"] if one.get("containers") == ["gpgrad_core"])
    (told,) = blocks(GUIDE / "architecture.md", "text")
    assert told.splitlines() == core["layers"]


@every_page
def test_files_named_in_the_text_exist(page: Path) -> None:
    for text in quoted(page):
        for name in re.findall(r"(?<![\w./-])[\w./-]+/[\w.-]+\.(?:py|toml|md)\b", text):
            if name.isupper() or re.search(r"[A-Z]{4,}", name.removesuffix(".md")):
                continue  # NAME, DATASET: for the reader to fill in
            if name.split("/")[0] in ("hour", "report", "trajectory"):
                continue  # what a command writes
            if name.endswith(("/foo.py", "/steepness.py")):
                continue  # the examples of recipes
            assert any((root / name).exists() for root in (ROOT, ROOT / "gpgrad_core")), name
        for name in re.findall(r"\b(?:gpgrad_core|app|tests|assets)(?:/\w+)+/?(?=\s|$)", text):
            assert (ROOT / name).exists() or "NAME" in name, name


def test_every_verb_has_its_row() -> None:
    rows = re.findall(r"^\| `gpgrad (\w+)", read(GUIDE / "commands.md"), flags=re.MULTILINE)
    assert rows == list(VERBS)


@pytest.mark.parametrize("verb", VERBS)
def test_flags_of_the_commands_exist(verb: str) -> None:
    page = read(GUIDE / "commands.md")
    row = next(line for line in page.splitlines() if line.startswith(f"| `gpgrad {verb}"))
    for flag in re.findall(r"--[\w.-]+", row):
        assert flag in help_of(verb)


@every_page
def test_flags_in_the_text_exist(page: Path) -> None:
    for text in quoted(page):
        if re.search(r"\b(pip|pytest|python)\b", text) and "gpgrad " not in text:
            continue  # other people's commands
        ours = re.sub(r"^#?.*\b(dask|srun|helm|SBATCH)\b.*$", "", text, flags=re.MULTILINE)
        for flag in re.findall(r"(?<![\w-])--[\w.-]+", ours):
            assert flag in flags_of_all(), flag


@every_page
def test_tasks_in_the_text_exist(page: Path) -> None:
    tasks = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["poe"]["tasks"]
    for text in quoted(page):
        for task in re.findall(r"(?:^|/| )poe ([\w-]+)", text):
            assert task in tasks


def test_every_picture_is_used_and_there() -> None:
    used = {
        Path(link).name
        for page in PAGES
        for link in re.findall(r"\]\(([^)]*pictures/[^)]+)\)", read(page))
    }
    assert used == {path.name for path in (ROOT / "assets" / "pictures").iterdir()}


def test_the_reference_has_all_that_is_public() -> None:
    reference = "\n".join(read(page) for page in (GUIDE / "api").glob("*.md"))
    named = re.findall(r"^\.\. auto(?:class|function):: (\w+)", reference, flags=re.MULTILINE)
    assert sorted(named) == sorted(set(gg.__all__) - {"__version__"})


def test_citation_names_the_paper_of_the_readme() -> None:
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    assert citation["cff-version"] == "1.2.0"
    assert {"title", "message", "authors", "license"} <= citation.keys()
    paper = citation["preferred-citation"]
    assert f"title     = {{{paper['title']}}}" in README
    assert f"year      = {{{paper['year']}}}" in README
    assert all(author["family-names"].split("-")[0][:2] in README for author in paper["authors"])


@pytest.mark.parametrize("name", ["bug", "wrong_verdict", "feature"])
def test_issue_forms_can_be_read(name: str) -> None:
    form = yaml.safe_load((ROOT / ".github" / "ISSUE_TEMPLATE" / f"{name}.yml").read_text())
    assert {"name", "description", "body"} <= form.keys()
    fields = [field for field in form["body"] if field["type"] != "markdown"]
    assert len({field["id"] for field in fields}) == len(fields)
    assert all(field["attributes"]["label"] for field in fields)
