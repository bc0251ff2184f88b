"""Work that is cancelled."""

from gpgrad_core.run import Cancelled, Progress


def cancelling(beyond: float = -1.0) -> Progress:
    """Cancel work as soon as it tells that it is beyond a fraction; if none is given, at once."""

    def hear(fraction: float) -> None:
        if fraction > beyond:
            raise Cancelled

    return hear
