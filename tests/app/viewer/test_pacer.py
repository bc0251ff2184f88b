import threading
import time

from app.viewer.runner import Pacer
from tests.waiting import PATIENCE


def test_the_last_wish_is_fulfilled_and_few_between() -> None:
    wish, served = [0], list[int]()
    pacer: Pacer[str] = Pacer(lambda _: served.append(wish[0]), 0.05, "test")
    begun = time.monotonic()
    for number in range(200):
        wish[0] = number
        pacer.ask("a")
        time.sleep(0.001)
    assert pacer.wait_idle(PATIENCE)
    assert served[-1] == 199
    assert len(served) <= 2 + (time.monotonic() - begun) / 0.05
    pacer.close()


def test_each_key_is_served_and_an_error_ends_nothing() -> None:
    served: list[str] = []
    done = threading.Event()

    def act(key: str) -> None:
        if key == "bad":
            raise ValueError(key)
        served.append(key)
        done.set()

    pacer: Pacer[str] = Pacer(act, 0.0, "test")
    for key in ("bad", "a", "b"):
        pacer.ask(key)
    assert done.wait(PATIENCE)
    assert pacer.wait_idle(PATIENCE)
    assert sorted(served) == ["a", "b"]
    pacer.close()
