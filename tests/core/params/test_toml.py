import tomllib

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gpgrad_core.errors import InputError
from gpgrad_core.params.toml import toml_lines, toml_value

scalars = (
    st.text()
    | st.booleans()
    | st.integers(-(2**63), 2**63 - 1)
    | st.floats(allow_nan=False, allow_infinity=False)
)
values = scalars | st.lists(scalars, max_size=3)
keys = st.text("abcdefgh_-", min_size=1, max_size=6)
tables = st.recursive(
    st.dictionaries(keys, values, max_size=3),
    lambda inner: st.dictionaries(keys, values | inner, max_size=3),
    max_leaves=6,
)


@settings(max_examples=30)
@given(table=tables)
def test_what_is_written_is_read_back(table: dict[str, object]) -> None:
    assert tomllib.loads("\n".join(toml_lines(table))) == table


def test_what_toml_does_not_have_is_refused() -> None:
    with pytest.raises(InputError, match="cannot hold None"):
        toml_value(None)
