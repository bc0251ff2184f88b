"""``python -m app`` is the console script ``gpgrad``."""

import sys


def main() -> None:
    """Run one verb and leave with its exit code."""
    try:
        # Within the block: a Ctrl-C while all is loaded, about a second, is no traceback either.
        from app.cli import run  # noqa: PLC0415
    except KeyboardInterrupt:
        sys.exit(130)
    sys.exit(run(sys.argv[1:]))


if __name__ == "__main__":
    main()
