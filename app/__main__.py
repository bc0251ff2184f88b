"""``python -m app`` is the console script ``gpgrad``."""

import sys

from app.ending import code_of, leave, open_streams, reason_of, termination_raised


def main() -> None:
    """Run one verb and leave with its exit code."""
    open_streams()
    try:
        with termination_raised():
            # Within the block: to be stopped while all is loaded, about a second, is no traceback
            # either.
            from app.cli import run  # noqa: PLC0415

            code = run(sys.argv[1:])
    except KeyboardInterrupt as stopped:
        sys.stderr.write(f"gpgrad: {reason_of(stopped)}\n")
        code = code_of(stopped)
    except (MemoryError, ImportError) as error:
        sys.stderr.write(f"gpgrad: cannot be loaded: {error or 'there is too little memory'}\n")
        code = 2
    except SystemExit:  # after help was printed
        code = 0
    leave(code)


if __name__ == "__main__":
    main()
