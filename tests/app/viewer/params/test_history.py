from hypothesis import given
from hypothesis import strategies as st

from app.viewer.params.history import LONGEST, History

values = st.lists(st.integers(0, 3), max_size=30)


@given(values=values)
def test_undoing_all_and_redoing_all_comes_back(values: list[int]) -> None:
    history = History(0)
    for value in values:
        history = history.push(value)
    end, steps = history, len(history.past)
    for _ in range(steps):
        history = history.undo()
    assert history.present == 0
    assert history.undo() is history
    for _ in range(steps):
        history = history.redo()
    assert history == end
    assert history.redo() is history


def test_a_new_value_forgets_what_was_undone() -> None:
    history = History(1).push(2).push(3).undo().push(4)
    assert history == History(4, past=(1, 2))
    assert history.push(4) is history


def test_the_oldest_are_forgotten() -> None:
    history = History(0)
    for value in range(1, LONGEST + 50):
        history = history.push(value)
    assert len(history.past) == LONGEST
