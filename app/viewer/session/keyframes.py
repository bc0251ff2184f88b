"""Keyframes: what a demonstration shows, step by step, each a view with a sentence."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any, TypeAlias

from msgspec import Meta, Struct

from app.viewer.session.state import Camera, Subject, ViewOptions
from gpgrad_core.params import to_tables, with_tables
from gpgrad_core.reading.records import as_builtins, as_record
from gpgrad_core.types import Coordinate

Place: TypeAlias = tuple[Coordinate, Coordinate, Coordinate]
MOST_KEYFRAMES, MOST_LETTERS = 50, 200
"""Of a session's file, and of the words of each."""
Words: TypeAlias = Annotated[str, Meta(max_length=MOST_LETTERS)]


@dataclass(frozen=True)
class Keyframe:
    """A step of a demonstration; its motion follows from the step before."""

    title: str  # what the step shows, in a few words
    line: str = ""  # the figures of it
    options: ViewOptions = field(default_factory=ViewOptions)
    camera: Camera | None = None  # None frames what is shown
    subject: Subject = "pair"


class CameraTable(Struct):
    """A camera in a session's file."""

    position: Place
    look_at: Place

    @property
    def camera(self) -> Camera:
        return Camera(self.position, self.look_at)


class _Table(Struct, omit_defaults=True, forbid_unknown_fields=True):
    title: Words
    line: Words = ""
    scene: Subject = "pair"
    view: dict[str, object] = {}
    camera: CameraTable | None = None


class _Tables(Struct):
    keyframes: Annotated[list[_Table], Meta(max_length=MOST_KEYFRAMES)]


def tables_of_keyframes(keyframes: tuple[Keyframe, ...]) -> list[dict[str, Any]]:
    """Write keyframes as tables of a TOML file; `read_keyframes` reads them back."""
    rows: list[dict[str, Any]] = []
    for frame in keyframes:
        camera = frame.camera and CameraTable(frame.camera.position, frame.camera.look_at)
        view = to_tables(frame.options)
        rows.append(as_builtins(_Table(frame.title, frame.line, frame.subject, view, camera)))
    return [{key: value for key, value in row.items() if value is not None} for row in rows]


def read_keyframes(tables: object, where: str, rules: Mapping[str, str]) -> tuple[Keyframe, ...]:
    """Read keyframes from the tables of a file, which a message names as ``where``."""
    rows = as_record({"keyframes": tables}, _Tables, where, rules).keyframes
    return tuple(
        Keyframe(
            row.title,
            row.line,
            with_tables(ViewOptions(), row.view, f"{where}, keyframes[{k}], view"),
            row.camera and row.camera.camera,
            row.scene,
        )
        for k, row in enumerate(rows)
    )
