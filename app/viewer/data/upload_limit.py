"""Stops uploads that are too large before they fill the memory.

viser gathers whatever a page sends, and reports it when it is complete. What is used here is not
part of its public interface, so its version is pinned to the minor.
"""

from collections.abc import Callable
from typing import Any

from viser import _messages as messages

from app.viewer.host import Host


def limit_uploads(host: Host, most_bytes: int, on_refused: Callable[[str, int], None]) -> None:
    """Drop an upload as soon as it is known to be too large.

    Args:
        host: Whose upload buttons are meant.
        most_bytes: Largest file.
        on_refused: Given the name of the file and its size as the page gave it.
    """
    gui: Any = host.gui
    uploads: dict[str, Any] = gui._current_file_upload_states

    def refuse(transfer: str, source: str | None) -> None:
        upload = uploads.pop(transfer)
        size = upload["total_bytes"]
        # So that the page takes its notice of a running upload away.
        gui._websock_interface.queue_message(
            messages.FileTransferPartAck(source, transfer, size, size)
        )
        on_refused(upload["filename"], size)

    def started(client_id: int, message: messages.FileTransferStartUpload) -> None:
        del client_id
        if message.transfer_uuid in uploads and message.size_bytes > most_bytes:
            refuse(message.transfer_uuid, message.source_component_uuid)

    def arrived(client_id: int, message: messages.FileTransferPart) -> None:
        del client_id
        upload = uploads.get(message.transfer_uuid)
        if upload is not None and upload["transferred_bytes"] > most_bytes:  # more than it said
            refuse(message.transfer_uuid, message.source_component_uuid)

    gui._websock_interface.register_handler(messages.FileTransferStartUpload, started)
    gui._websock_interface.register_handler(messages.FileTransferPart, arrived)
