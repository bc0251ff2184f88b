"""Files that come while other pages drag sliders; takes a minute."""

import io
import re
import subprocess
import threading
import time
import uuid
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from gpgrad_core.simulation.demo import demo_path
from tests.end_to_end.process import start
from tests.support.page import ProtocolPage

PART = 65_536


@pytest.fixture
def url(tmp_path: Path) -> Iterator[str]:
    """Of a viewer of the demo, whose pages share a session."""
    flags = ("--port", "0", "--no-open", "--cache", "none", "--config", tmp_path / "config")
    with start("view", *flags, "--memory", "1GB", stdout=subprocess.PIPE) as process:
        try:
            assert process.stdout is not None
            said = next((line for line in process.stdout if "http" in line), "")
            address = re.search(r"http://[^/\s]+", said)
            assert address, said
            assert any("is open" in line for line in process.stdout)
            yield address[0]
        finally:
            process.terminate()


def visit(url: str) -> ProtocolPage:
    page = ProtocolPage(url)
    page.wait(lambda: page.find("Length-scale") is not None, "the sliders", 120)
    return page


def drag(page: ProtocolPage, going: Callable[[], bool], pause: float) -> None:
    count = 0
    while going():
        count += 1
        page.set("Length-scale", round(0.2 + 0.01 * (count % 30), 3))
        time.sleep(pause)


def archive(name: str, num_submaps: int) -> bytes:
    """Some submaps of the demo, with two megabytes beside them, so that it comes in many parts."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as file:
        for cloud in sorted((demo_path() / "submaps").iterdir())[:num_submaps]:
            file.write(cloud, f"{name}/submaps/{cloud.name}")
        file.writestr(f"{name}/notes.bin", bytes(range(256)) * 8000)
    return buffer.getvalue()


def send_in_parts(page: ProtocolPage, name: str, content: bytes) -> None:
    widget = page.find("Upload clouds")["uuid"]
    ids = {"source_component_uuid": widget, "transfer_uuid": uuid.uuid4().hex}
    parts = [content[k : k + PART] for k in range(0, len(content), PART)]
    about = {"part_count": len(parts), "size_bytes": len(content)}
    page.send(
        {"type": "FileTransferStartUpload", **ids, "filename": name, "mime_type": "", **about}
    )
    for k, part in enumerate(parts):
        page.send({"type": "FileTransferPart", **ids, "part_index": k, "content": part})


def told(page: ProtocolPage, words: str) -> bool:
    """Say whether the panels tell something."""
    return any(
        words in str(widget["props"].get("content", "")) for widget in list(page.widgets.values())
    )


def test_files_arrive_whole_while_other_pages_drag(url: str) -> None:
    """One after the other, for they open in the session that all share."""
    dragging = [visit(url) for _ in range(4)]
    ended = threading.Event()
    threads = [
        threading.Thread(target=drag, args=(page, lambda: not ended.is_set(), 0.05), daemon=True)
        for page in dragging
    ]
    for thread in threads:
        thread.start()
    sender = visit(url)
    try:
        for k in range(3):
            name, begun = f"sent-{k}", time.monotonic()
            send_in_parts(sender, f"{name}.zip", archive(name, 2 + k))
            sender.wait(lambda k=k: told(sender, f" · {2 + k} submaps"), name)
            print(f"{name} was open after {time.monotonic() - begun:.1f} s")
    finally:
        ended.set()
        for thread in threads:
            thread.join(30)
        for page in (*dragging, sender):
            page.close()
