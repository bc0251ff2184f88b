"""A page without a browser: it speaks the viewer's protocol, and records what it receives."""

import hashlib
import threading
import time
import uuid
from collections.abc import Callable
from contextlib import nullcontext, suppress
from types import SimpleNamespace
from typing import Any

import msgspec
import numpy as np
import viser
import zstandard
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect
from websockets.typing import Origin, Subprotocol


class FakePage(viser.ClientHandle):
    """A page that records what it is sent, and draws a red picture.

    Attributes:
        files: Content by the name of each file.
        scripts: What it was to run, and what was written into its panels.
        notes: Titles of the notifications.
    """

    def __init__(self, *, draws: bool = True) -> None:
        self.client_id = 1
        self.files: dict[str, bytes] = {}
        self.scripts: list[str] = []
        self.notes: list[str] = []
        self.draws = draws
        camera: Any = SimpleNamespace(
            image_height=30,
            image_width=40,
            aspect=40 / 30,
            fov=0.785,
            position=np.array([1.0, -2.0, 3.5]),
            look_at=np.zeros(3),
            on_update=lambda act: act,
        )
        self.camera = camera
        self._websock_connection: Any = SimpleNamespace(
            queue_message=lambda message: self.scripts.append(
                getattr(message, "source", "") or getattr(message, "updates", {}).get("content", "")
            )
        )

    def atomic(self) -> Any:
        return nullcontext()

    def flush(self) -> None:
        pass

    def add_notification(self, title: str, *_: Any, **__: Any) -> Any:
        self.notes.append(title)

    def send_file_download(self, filename: str, content: bytes, *_: Any, **how: Any) -> None:
        assert how["save_immediately"]
        self.files[filename] = content

    def get_render(self, **wanted: Any) -> np.ndarray:  # type: ignore[override]
        assert wanted["timeout"] > 0
        if not self.draws:
            raise TimeoutError
        picture = np.zeros((wanted["height"], wanted["width"], 4), np.uint8)
        picture[..., 0] = picture[..., 3] = 255
        return picture


CAMERA = {
    "type": "ViewerCameraMessage",
    "wxyz": (1.0, 0.0, 0.0, 0.0),
    "position": (0.0, -10.0, 10.0),
    "fov": 0.8,
    "near": 0.01,
    "far": 1000.0,
    "image_height": 600,
    "image_width": 960,
    "look_at": (0.0, 0.0, 0.0),
    "up_direction": (0.0, 0.0, 1.0),
}


class ProtocolPage:
    """Connects as a page does; its widgets and nodes are as the last message described them."""

    def __init__(self, url: str, cookie: str = "", path: str = "") -> None:
        self.widgets: dict[str, dict[str, Any]] = {}  # by uuid
        self.nodes: dict[str, dict[str, Any]] = {}  # by name; arrays as their digests
        self.received: list[tuple[float, str]] = []  # when each message came, for latencies
        # Where the server has put the camera last, and where it has turned it.
        self.looks_from: list[float] | None = None
        self.look_at: list[float] | None = None
        self.num_bytes = 0
        self.socket = connect(
            url.replace("http", "ws") + path,
            origin=Origin(url),
            additional_headers={"Cookie": cookie} if cookie else {},
            subprotocols=[Subprotocol(f"viser-v{viser.__version__}")],
            max_size=None,
            compression=None,
            open_timeout=60,  # the machine may be busy
        )
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()
        self.send(CAMERA)

    def send(self, message: dict[str, Any]) -> None:
        """Send a message."""
        self.socket.send(msgspec.msgpack.encode(message))

    def close(self) -> None:
        """Disconnect."""
        self.socket.close()
        self._reader.join(timeout=5)

    def find(self, label: str) -> dict[str, Any]:
        """Find the widget whose label begins with a text."""
        widgets = [
            widget
            for widget in list(self.widgets.values())
            if str(widget["props"].get("label", "")).startswith(label)
        ]
        assert len(widgets) == 1, f"{len(widgets)} widgets are called {label!r}"
        return widgets[0]

    def set(self, label: str, value: object) -> None:
        """Change a widget, as a user does."""
        widget = self.find(label)
        widget["value"] = value
        self.send({"type": "GuiUpdateMessage", "uuid": widget["uuid"], "updates": {"value": value}})

    def click_scene(self, origin: tuple[float, ...], direction: tuple[float, ...]) -> None:
        """Click where a line of sight leads."""
        self.send(
            {
                "type": "ScenePointerMessage",
                "event_type": "click",
                "ray_origin": origin,
                "ray_direction": direction,
                "screen_pos": ((0.5, 0.5),),
                "modifier": None,
            }
        )

    def move_gizmo(self, name: str, position: tuple[float, ...], wxyz: tuple[float, ...]) -> None:
        """Drag the handles of a node to a place."""
        kind = "TransformControlsUpdateMessage"
        self.send({"type": kind, "name": name, "wxyz": wxyz, "position": position})

    def upload(self, label: str, name: str, content: bytes) -> None:
        """Send a file in one part."""
        ids = {"source_component_uuid": self.find(label)["uuid"], "transfer_uuid": uuid.uuid4().hex}
        about = {"filename": name, "mime_type": "", "part_count": 1, "size_bytes": len(content)}
        self.send({"type": "FileTransferStartUpload", **ids, **about})
        self.send({"type": "FileTransferPart", **ids, "part_index": 0, "content": content})

    def html(self) -> str:
        """Return all text in the panels."""
        return "".join(
            str(widget["props"].get("content", "")) for widget in [*self.widgets.values()]
        )

    def wait(self, condition: Callable[[], bool], what: str, timeout: float = 60.0) -> None:
        """Wait until a condition holds."""
        end = time.monotonic() + timeout
        while True:
            with suppress(AssertionError, RuntimeError):  # not there yet, or changed meanwhile
                if condition():
                    return
            assert time.monotonic() < end, f"waited {timeout:.0f} s for {what}"
            time.sleep(0.02)

    def seen(self) -> dict[str, object]:
        """Return everything that the user sees, to compare it with another page."""
        widgets = {
            uuid: (widget.get("value"), widget["props"]) for uuid, widget in self.widgets.items()
        }
        return {**widgets, **self.nodes}

    def _read(self) -> None:
        with suppress(ConnectionClosed):
            for frame in self.socket:
                assert isinstance(frame, bytes)
                self.num_bytes += len(frame)
                for message in _messages(frame):
                    self.take(message)

    def take(self, message: dict[str, Any]) -> None:
        kind = message["type"]
        self.received.append((time.monotonic(), kind))
        if kind == "GuiUpdateMessage" and message["uuid"] in self.widgets:
            widget = self.widgets[message["uuid"]]
            for name, value in message["updates"].items():
                (widget if name == "value" else widget["props"])[name] = value
        elif kind == "GuiRemoveMessage":
            self.widgets.pop(message["uuid"], None)
        elif kind.startswith("Gui") and "props" in message and "uuid" in message:
            self.widgets[message["uuid"]] = message
        elif kind == "SceneNodeUpdateMessage" and message["name"] in self.nodes:
            self.nodes[message["name"]].update(message["updates"])
            for name in message["updates"]:
                self.received.append((time.monotonic(), f"{message['name']}.{name}"))
        elif kind == "SetCameraPositionMessage" and not message["initial"]:
            self.looks_from = list(message["position"])
        elif kind == "SetCameraLookAtMessage" and not message["initial"]:
            self.look_at = list(message["look_at"])
        elif kind == "RemoveSceneNodeMessage":
            self.nodes.pop(message["name"], None)
        elif "props" in message and "name" in message:
            self.nodes[message["name"]] = dict(message["props"])
        elif kind in ("SetPositionMessage", "SetOrientationMessage"):
            values = {key: value for key, value in message.items() if key not in ("type", "name")}
            self.nodes.setdefault(message["name"], {}).update(values)


def _messages(frame: bytes) -> list[dict[str, Any]]:
    """Decode a frame: compressed messages, then the arrays to which they refer."""
    length = int.from_bytes(frame[8:16], "little")
    inner = msgspec.msgpack.decode(zstandard.ZstdDecompressor().decompress(frame[16 : 16 + length]))
    offset, digests = 16 + length, []
    for size in inner["binaryBufferLengths"]:
        offset += -offset % 8
        digests.append(hashlib.sha256(frame[offset : offset + size]).hexdigest())
        offset += size
    return [_resolved(message, digests) for message in inner["messages"]]


def _resolved(value: Any, digests: list[str]) -> Any:
    if isinstance(value, dict):
        if "__binary_index" in value:
            return digests[value["__binary_index"]]
        return {key: _resolved(inner, digests) for key, inner in value.items()}
    if isinstance(value, list):
        return [_resolved(inner, digests) for inner in value]
    return value
