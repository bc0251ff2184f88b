"""The notebooks run as they stand, and are kept without what they showed."""

import re
import sys
from pathlib import Path
from typing import Any

import nbformat
import pytest

from tests.end_to_end.process import ROOT, environment

EXAMPLES = ROOT / "assets" / "examples"
SHOWS = {
    "from_a_cloud_to_a_closure.ipynb": (r"Loop closure: 007 on 001", 2),
    "your_bag_to_a_corrected_map.ipynb": (r"[1-9]\d* loop closures moved a submap", 1),
}
"""By notebook: what it says, and how many pages it shows."""


def read(name: str) -> Any:
    return nbformat.read(EXAMPLES / name, as_version=4)


def test_every_notebook_is_tried() -> None:
    assert sorted(path.name for path in EXAMPLES.glob("*.ipynb")) == sorted(SHOWS)


@pytest.mark.parametrize("name", SHOWS)
def test_notebook_is_short_and_opens_with_a_picture_but_no_outputs(name: str) -> None:
    notebook = read(name)
    nbformat.validate(notebook)
    assert len(notebook.cells) <= 10
    (picture,) = re.findall(r"^!\[.+\]\((.+)\)$", notebook.cells[0].source, re.MULTILINE)
    assert (EXAMPLES / picture).is_file()
    for cell in notebook.cells:
        if cell.cell_type == "code":
            assert (cell.outputs, cell.execution_count) == ([], None)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")  # of the notebook's client; the notebook is another process
@pytest.mark.parametrize("name", SHOWS)
def test_notebook_runs(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    nbclient = pytest.importorskip("nbclient", reason="nbclient is not installed")
    pytest.importorskip("gtsam", reason="GTSAM has no wheels for this system")
    for key, value in environment().items():
        monkeypatch.setenv(key, value)
    monkeypatch.setenv("JUPYTER_PATH", str(tmp_path / "jupyter"))
    install_kernel(tmp_path / "jupyter" / "kernels" / "python3")
    notebook = read(name)
    nbclient.NotebookClient(
        notebook,
        timeout=600,
        kernel_name="python3",
        resources={"metadata": {"path": str(tmp_path)}},
    ).execute()
    said, num_pages = SHOWS[name]
    outputs = [output for cell in notebook.cells for output in cell.get("outputs", ())]
    assert not any(output.output_type == "stream" and output.name == "stderr" for output in outputs)
    shown = [output.data.get("text/html", "") for output in outputs if "data" in output]
    assert re.search(said, "".join(shown) + "".join(o.get("text", "") for o in outputs))
    assert sum(html.startswith("<iframe srcdoc=") for html in shown) == num_pages


def install_kernel(folder: Path) -> None:
    """Describe this Python as a kernel, so that none of the user's is taken."""
    folder.mkdir(parents=True)
    arguments = [sys.executable, "-m", "ipykernel_launcher", "-f", "{connection_file}"]
    words = ", ".join(f'"{argument}"' for argument in arguments).replace("\\", "\\\\")
    (folder / "kernel.json").write_text(
        f'{{"argv": [{words}], "display_name": "Python 3", "language": "python"}}', encoding="utf-8"
    )
