"""What people do on the pages of a viewer that is in use for long."""

import io
import json
import random
import threading
import time
import zipfile
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from websockets.exceptions import ConnectionClosed

from gpgrad_core.io.folder import write_dataset
from tests.support.page import ProtocolPage
from tests.support.synthetic import make_dataset

RANGES = {
    "Length-scale": (0.2, 0.8),
    "Noise": (0.02, 0.1),
    "resolution": (0.03, 0.12),
    "trials": (500, 8000),
    "max keypoints": (200, 1500),
}
"""Values that keep a picture well below a second; the other sliders go from end to end."""
MAIN = ("Length-scale", "Noise", "Variance mask", "Inlier radius", "Minimum score")
MORE = (
    *("noise factor", "noise growth", "signal std", "resolution", "scale", "max keypoints"),
    *("gradient range", "ratio", "trials", "hypotheses", "searched", "max std"),
)
LOOKS = ("Layer", "Colours", "Layout", "Compare", "Masked cells", "Colour by", "Poses")
TICKS = ("Surfaces", "Point clouds", "Keypoints", "Inlier lines", "Outlier lines", "Hillshade")


class SoakPage(ProtocolPage):
    """A page that also sends files and saves those that it gets."""

    def __init__(self, url: str) -> None:
        self.files: dict[str, bytes] = {}
        self._said = 0
        self._coming: dict[str, tuple[str, list[bytes]]] = {}
        super().__init__(url)

    def find(self, label: str) -> dict[str, Any]:
        """Find a widget by its whole label; a unit may follow."""
        widgets = [
            widget
            for widget in list(self.widgets.values())
            if str(widget["props"].get("label", "")).partition(" [")[0] == label
        ]
        assert len(widgets) == 1, f"{len(widgets)} widgets are called {label!r}"
        return widgets[0]

    def can(self, label: str) -> bool:
        """Say whether a widget is there to be used."""
        with suppress(AssertionError):
            props = self.find(label)["props"]
            return bool(props["visible"]) and not props.get("disabled", False)
        return False

    def press(self, label: str) -> None:
        """Press a button, if it is there to be pressed."""
        if self.can(label):
            self.send(
                {
                    "type": "GuiUpdateMessage",
                    "uuid": self.find(label)["uuid"],
                    "updates": {"value": True},
                }
            )

    def choose(self, label: str, rng: random.Random) -> None:
        """Choose any option, if there is a choice."""
        if self.can(label):
            options = self.find(label)["props"]["options"]
            self.set(label, rng.choice(options))

    def say(self, name: str, **data: str) -> None:
        """Say something as a script of a page does."""
        self._said += 1
        said = {"number": self._said, "times": 1, "name": name, "data": data}
        self.set("bridge", json.dumps(said))

    def ping(self) -> float:
        """Measure how long the viewer takes to answer [s]."""
        start = time.monotonic()
        assert self.socket.ping().wait(60.0), "no answer in 60 s"
        return time.monotonic() - start

    def save_session(self, timeout: float = 20.0) -> bytes:
        """Save the session as a file."""
        self.files.clear()
        self.press("Save session")
        self.wait(lambda: any(name.endswith(".toml") for name in self.files), "a file", timeout)
        return next(content for name, content in self.files.items() if name.endswith(".toml"))

    def take(self, message: dict[str, Any]) -> None:
        super().take(message)
        del self.received[:-1000]
        if message["type"] == "FileTransferStartDownload":
            self._coming[message["transfer_uuid"]] = (message["filename"], [])
        elif message["type"] == "FileTransferPart":
            name, parts = self._coming[message["transfer_uuid"]]
            parts.append(message["content"])
            self.files[name] = b"".join(parts)


def any_value(page: SoakPage, label: str, rng: random.Random) -> float:
    """Give a value that a slider can have."""
    props = page.find(label)["props"]
    low, high = RANGES.get(label, (props["min"], props["max"]))
    first, last = (round((end - props["min"]) / props["step"]) for end in (low, high))
    # To three digits, as the page does over decades.
    return float(f"{props['min'] + props['step'] * rng.randint(first, last):.3g}")


def drag(page: SoakPage, label: str, rng: random.Random, events: int) -> float:
    """Drag a slider; gives its last value."""
    value = any_value(page, label, rng)
    for _ in range(events):
        value = any_value(page, label, rng)
        page.set(label, value)
        time.sleep(0.02)
    return value


class Person:
    """Uses one page after the other, until told to stop."""

    def __init__(self, url: str, seed: int, files: Mapping[str, bytes], stay: float) -> None:
        """Begin; on a page it stays for a mean time [s], and then opens another."""
        self.url, self.files, self.stay = url, files, stay
        self.page: SoakPage | None = None
        self.errors: list[str] = []
        self.num_acts = self.num_visits = 0
        self.answers: list[float] = []  # how long the viewer took to answer [s]
        self._rng = random.Random(seed)
        self._session = b""
        self._stop, self._may_act, self._acting = threading.Event(), threading.Event(), False
        self._may_act.set()
        self._thread = threading.Thread(target=self._live, daemon=True)
        self._thread.start()

    def rest(self) -> None:
        """Stop using the page until `go_on`; returns when the last act is over."""
        self._may_act.clear()
        while self._acting:
            time.sleep(0.01)

    def go_on(self) -> None:
        """Use the page again."""
        self._may_act.set()

    def end(self) -> None:
        """Leave for good."""
        self._stop.set()
        self._may_act.set()
        self._thread.join()

    def _live(self) -> None:
        while not self._stop.is_set():
            try:
                self._visit()
            except (AssertionError, OSError, ConnectionClosed) as error:
                self.errors.append(f"{type(error).__name__}: {error}")
                self._stop.wait(1.0)

    def _visit(self) -> None:
        self._may_act.wait()
        page = self.page = SoakPage(self.url)
        self.num_visits += 1
        try:
            page.wait(lambda: page.can("Save page"), "all of a page", 60)
            leave = time.monotonic() + self._rng.expovariate(1 / self.stay)
            while not self._stop.is_set() and (time.monotonic() < leave):
                self._act_once(page)
                self._stop.wait(self._rng.expovariate(2.0))
            self._may_act.wait()  # nobody leaves while all rest
        finally:
            self.page = None
            page.close()

    def _act_once(self, page: SoakPage) -> None:
        self._acting = True
        try:
            if not self._may_act.is_set():
                return
            act = self._rng.choices(list(ACTS), list(ACTS.values()))[0]
            act(self, page, self._rng)
            self.num_acts += 1
            self.answers.append(page.ping())
        finally:
            self._acting = False
            self._may_act.wait()

    # What can be done.

    def main_slider(self, page: SoakPage, rng: random.Random) -> None:
        drag(page, rng.choice(MAIN), rng, rng.randint(3, 30))

    def other_slider(self, page: SoakPage, rng: random.Random) -> None:
        label = rng.choice(MORE)
        if page.can(label):
            drag(page, label, rng, rng.randint(1, 10))

    def pair(self, page: SoakPage, rng: random.Random) -> None:
        page.say(
            "pair",
            act=rng.choice(("next", "previous", "swap")),
            role=rng.choice(("query", "database")),
        )

    def look(self, page: SoakPage, rng: random.Random) -> None:
        page.choose(rng.choice(LOOKS), rng)

    def tick(self, page: SoakPage, rng: random.Random) -> None:
        page.set(rng.choice(TICKS), rng.random() < 0.5)

    def association(self, page: SoakPage, rng: random.Random) -> None:
        page.choose("Step association", rng)

    def mode(self, page: SoakPage, rng: random.Random) -> None:
        page.choose(rng.choice(("Mode", "Show")), rng)

    def undo(self, page: SoakPage, rng: random.Random) -> None:
        page.press(rng.choice(("Undo", "Undo", "Redo", "Reset parameters")))

    def preset(self, page: SoakPage, rng: random.Random) -> None:
        page.set("Preset", rng.choice(("default", "rough ground", "smooth ground")))

    def save(self, page: SoakPage, rng: random.Random) -> None:
        del rng
        self._session = page.save_session()

    def restore(self, page: SoakPage, rng: random.Random) -> None:
        del rng
        if self._session:
            page.upload("Restore session", "saved.gpgrad.toml", self._session)

    def upload_parameters(self, page: SoakPage, rng: random.Random) -> None:
        length = rng.randint(20, 80) / 100
        page.upload("Upload parameters", "p.toml", f"[map]\nlength_scale = {length}\n".encode())

    def open_data(self, page: SoakPage, rng: random.Random) -> None:
        kind = rng.choice(("dataset.zip", "cloud.ply", "folder", "demo", "demo"))
        if kind == "demo":
            page.set("Open", "Load demo")
        elif kind == "folder":
            page.set("Folder", self.files[kind].decode())
            page.set("Open", "Load")
        else:
            page.upload("Upload clouds or a .zip", kind, self.files[kind])

    def long_work(self, page: SoakPage, rng: random.Random) -> None:
        page.press(rng.choice(("Run all pairs", "Find closures", "Fit to these submaps")))
        self._stop.wait(rng.uniform(0.2, 5.0))
        page.press(rng.choice(("Cancel", "Cancel work", "Cancel fit", "Optimise")))

    def export(self, page: SoakPage, rng: random.Random) -> None:
        page.choose("Map as", rng)
        page.press(rng.choice(("Export map", "Export closures")))

    def move(self, page: SoakPage, rng: random.Random) -> None:
        page.set("Move the query", rng.random() < 0.3)


ACTS: dict[Callable[[Person, SoakPage, random.Random], None], float] = {
    Person.main_slider: 40,
    Person.other_slider: 10,
    Person.pair: 12,
    Person.look: 10,
    Person.tick: 6,
    Person.association: 5,
    Person.mode: 4,
    Person.undo: 3,
    Person.preset: 1,
    Person.save: 2,
    Person.restore: 1.5,
    Person.upload_parameters: 1,
    Person.open_data: 1.5,
    Person.long_work: 1,
    Person.export: 1,
    Person.move: 1,
}
"""What people do, and how often."""


def make_files(folder: Path) -> dict[str, bytes]:
    """Make what may be uploaded or opened: a small dataset, zipped and as it is, and a cloud."""
    small = folder / "small"
    write_dataset(make_dataset(num_points=3000, name="small"), small)
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        for path in sorted(small.rglob("*.*")):
            archive.write(path, path.relative_to(folder))
    cloud = min(small.rglob("*.ply"))
    return {
        "dataset.zip": buffer.getvalue(),
        "cloud.ply": cloud.read_bytes(),
        "folder": str(small).encode(),
    }
