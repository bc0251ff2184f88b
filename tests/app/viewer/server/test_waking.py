"""A message reaches a waiting page from any thread, and only the loop touches who waits."""

import asyncio
import threading
from concurrent.futures import ThreadPoolExecutor

from viser import _messages as messages
from viser.infra._async_message_buffer import AsyncMessageBuffer

import app.viewer.server.internals  # noqa: F401 - puts it right


def in_a_thread(buffer: AsyncMessageBuffer) -> None:
    thread = threading.Thread(target=buffer.push, args=[messages.ResetGuiMessage()])
    thread.start()
    thread.join()


def test_a_message_of_any_thread_wakes_who_waits_in_the_loop() -> None:
    async def wait() -> None:
        buffer = AsyncMessageBuffer(asyncio.get_running_loop(), persistent_messages=False)
        waiting = asyncio.create_task(buffer.message_event.wait())
        await asyncio.sleep(0)
        in_a_thread(buffer)
        assert not buffer.message_event.is_set()  # that is left to the loop
        await asyncio.wait_for(waiting, 60)
        assert buffer.message_event.is_set()

    # In a thread of its own: where a browser was driven before, this one has a loop that runs.
    with ThreadPoolExecutor(1) as executor:
        executor.submit(asyncio.run, wait()).result()
