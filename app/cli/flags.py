"""Flags out of params dataclasses, and the reading of the command line."""

import contextlib
import io
import re
import shlex
from collections.abc import Generator, Mapping, Sequence
from dataclasses import MISSING, dataclass, field, fields, make_dataclass, replace
from functools import cache, partial
from pathlib import Path
from types import NoneType
from typing import Annotated, Any, Generic, TypeAlias, TypeVar, cast, get_args, get_type_hints

import tyro
from typing_extensions import Doc
from tyro.constructors import (
    ConstructorRegistry,
    PrimitiveConstructorSpec,
    PrimitiveTypeInfo,
    StructConstructorSpec,
    StructFieldSpec,
    StructTypeInfo,
)

from app.cli.terminal import one_line
from gpgrad_core.errors import InputError
from gpgrad_core.params import AUTOMATIC, Bounds, Field, fields_of

V = TypeVar("V")
P = TypeVar("P")

JSON = "--json"
JsonFlag: TypeAlias = Annotated[
    bool,
    Doc(
        "Print events as lines of JSON on standard output: progress, loop closures, warnings and "
        "the result."
    ),
]
PageFlag: TypeAlias = Annotated[
    bool, Doc("Also write page.html, one page of the whole dataset that opens without a viewer.")
]
Overwrite: TypeAlias = Annotated[bool, Doc("Replace what an earlier run wrote there.")]


class NotGiven(int):
    """Type of `NOT_GIVEN`; a number, because tyro takes numbers as defaults of any flag."""


NOT_GIVEN = NotGiven()
"""The value of a flag that the command line does not name."""


@dataclass(frozen=True, eq=False)
class Given(Generic[P]):
    """The parameters that the command line names, and no others.

    As the default of a verb's field it says which flags there are: one for each parameter. So the
    command line is read once, before any file, and still overrides the files' parameters.
    """

    params: type[P]
    # from the command line, by field name; a `Given` for a group
    values: Mapping[str, object] = field(default_factory=dict[str, object])

    def over(self, base: P) -> P:
        changes: dict[str, object] = {}
        for name, value in self.values.items():
            group = cast("Given[Any]", value) if isinstance(value, Given) else None
            changes[name] = value if group is None else group.over(getattr(base, name))
        return cast("P", replace(cast("Any", base), **changes))


def parse(verb: type[V], name: str, arguments: Sequence[str], summary: str) -> V:
    """Read a verb's arguments from what follows it on the command line."""
    # Every verb has the flag; what it does is done by what all of them speak through.
    told = make_dataclass(
        verb.__name__,
        [("json", JsonFlag, False)],
        bases=(verb,),
        frozen=True,
        kw_only=True,
        namespace={
            "typed": shlex.join(["gpgrad", name, *(word for word in arguments if word != JSON)])
        },
    )
    # What verbs share is keyword-only; a dataclass has its base's fields first, and help has them
    # last.
    known: dict[str, Any] = told.__dataclass_fields__
    order = sorted(known, key=lambda name: known[name].kw_only is True)
    setattr(told, "__dataclass_fields__", {name: known[name] for name in order})  # noqa: B010
    with one_line_usage():
        return tyro.cli(
            told,
            prog=" ".join(["gpgrad", name, *_required(verb)]),
            description=summary,
            args=arguments,
            registry=REGISTRY,
        )


def _required(verb: type) -> list[str]:
    """List the flags without a default, for the line on usage; tyro's own leaves them out."""
    words: list[str] = []
    hints = get_type_hints(verb, include_extras=True)
    for argument in fields(cast("Any", verb)):
        extras = get_args(hints[argument.name])[1:]
        optional = argument.default is not MISSING or argument.default_factory is not MISSING
        if not optional and tyro.conf.Positional not in extras:
            metavars = (getattr(extra, "metavar", None) for extra in extras)
            words.append(f"--{argument.name} {next(filter(None, metavars))}")
    return words


@contextlib.contextmanager
def one_line_usage() -> Generator[None]:
    """Turn tyro's box of several lines about a wrong usage into an error of one line."""
    box = io.StringIO()
    try:
        with contextlib.redirect_stderr(box):
            yield
    except SystemExit as leaving:
        if leaving.code:
            raise InputError(_unboxed(box.getvalue())) from leaving
        raise


def _unboxed(text: str) -> str:
    r"""What tyro's box says, in one line, without its title and the pointer to the help.

    >>> _unboxed("╭─ Parsing error ────╮\n│ --port: not a number │\n╰──────────────────────╯")
    '--port: not a number'
    >>> _unboxed(" Parsing error \n ------------- \n  --port: not a number\n")
    '--port: not a number'
    """
    rows = re.sub(r"\x1b\[[0-9;]*m", "", text).splitlines()
    # The box is of lines, or of blanks and hyphens where the output cannot show lines.
    start = next((k for k, row in enumerate(rows) if re.match(r"\u256d| -+ ?$", row)), -1)
    kept = [re.sub(r"[\u2500-\u257f]+|^[ -]+$", "", row) for row in rows[start + 1 :]]
    said = re.split(r"Argument helptext:|For full helptext", one_line(" ".join(kept)))[0]
    said = re.sub(r"^Missing from [^:]*:", "missing:", said.replace(" (required)", ""))
    return said.removeprefix("Error parsing ").strip()


def _flags_of_params(info: StructTypeInfo) -> StructConstructorSpec | None:
    if not isinstance(info.default, Given):
        return None
    params = cast("Given[Any]", info.default).params
    specs = tuple(
        _group(parameter) if parameter.is_group else _flag(parameter)
        for parameter in fields_of(params)
    )
    return StructConstructorSpec(partial(_given, params), specs)


def _given(params: type[P], /, **values: object) -> Given[P]:
    return Given(params, {name: value for name, value in values.items() if value is not NOT_GIVEN})


def _group(parameter: Field) -> StructFieldSpec:
    about = (parameter.kind.__doc__ or "").partition("\n\n")[0]
    return StructFieldSpec(
        parameter.name, Given, _nothing_given(cast("type", parameter.kind)), about
    )


@cache
def _nothing_given(params: type[P]) -> Given[P]:
    return Given(params)  # cached, because tyro knows defaults by their identity


def _flag(parameter: Field) -> StructFieldSpec:
    text = parameter.doc
    if parameter.bounds is not None:
        text += f" Range: {_range(parameter.bounds)}."
    if parameter.kind is bool:
        hint = tyro.conf.arg(help_behavior_hint=f"(default: {parameter.default})")
        return StructFieldSpec(parameter.name, cast("Any", Annotated[bool, hint]), NOT_GIVEN, text)
    choices = parameter.kind if isinstance(parameter.kind, tuple) else None
    metavar = (
        "{" + ",".join(choices) + "}" if choices else cast("type", parameter.kind).__name__.upper()
    )
    spec = PrimitiveConstructorSpec[object](
        nargs=1,
        metavar=f"{metavar}|None" if parameter.optional else metavar,
        instance_from_str=lambda words: _value(parameter, words[0]),
        is_instance=lambda _: True,
        str_from_instance=lambda _: [
            AUTOMATIC if parameter.default is None else str(parameter.default)
        ],
        choices=choices,
    )
    return StructFieldSpec(parameter.name, cast("Any", Annotated[object, spec]), NOT_GIVEN, text)


def _value(parameter: Field, word: str) -> object:
    if parameter.optional and word in ("None", AUTOMATIC):
        return None
    if isinstance(parameter.kind, tuple):
        return word
    value = _number(parameter.kind, word)
    if parameter.bounds is not None:
        parameter.bounds.check("the value", value)
    return value


def _number(kind: type, word: str) -> Any:
    try:
        return kind(word)
    except ValueError:  # no text is refused as a text or a path
        wanted = "a whole number" if kind is int else "a number"
        raise InputError(f"the value must be {wanted}, got {word!r}") from None


def _one_word(info: PrimitiveTypeInfo) -> PrimitiveConstructorSpec[Any] | None:
    """How tyro reads a number, and that None is the default of a flag but no word for it."""
    some = [part for part in get_args(info.type) if part is not NoneType]
    kind: Any = some[0] if len(some) == 1 else info.type
    optional = kind is not info.type
    if kind not in (int, float) and not (optional and kind in (str, Path)):
        return None
    return PrimitiveConstructorSpec(
        nargs=1,
        metavar=kind.__name__.upper(),
        instance_from_str=lambda words: _number(kind, words[0]),
        is_instance=lambda value: (value is None and optional) or isinstance(value, kind),
        str_from_instance=lambda value: ["none" if value is None else str(value)],
    )


def _range(bounds: Bounds) -> str:
    """Write the range of a parameter.

    >>> _range(Bounds(0.0, 20_000, 1.0, "m")), _range(Bounds(0.0, 1.0, 0.1, "1/m²"))
    ('0 to 20,000 m', '0 to 1 per m²')
    """
    unit = bounds.unit.replace("1/", "per ")
    return f"{bounds.low:,.10g} to {bounds.high:,.10g} {unit}".rstrip()


REGISTRY = ConstructorRegistry()
REGISTRY.struct_rule(_flags_of_params)
REGISTRY.primitive_rule(_one_word)
