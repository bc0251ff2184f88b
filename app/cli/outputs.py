"""What the verbs that take minutes have in common: they replace no output without being told to."""

from typing import Annotated, TypeAlias

from typing_extensions import Doc

Overwrite: TypeAlias = Annotated[bool, Doc("Replace what an earlier run wrote there.")]
