"""How every command-line tool ends."""

import sys
from collections.abc import Callable

from mrd_base.errors import InputError


def run_tool(work: Callable[[], None]) -> None:
    """Run ``work`` and leave the process as the tools' contract says.

    Status 0 when done, 2 after `InputError` (its line on stderr), 130 after Ctrl-C.
    """
    try:
        work()
    except InputError as error:
        print(f"error: {error}", file=sys.stderr)
        sys.exit(2)
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        sys.exit(130)
    except BrokenPipeError:
        # The reader of our output (``head``, a pager) has left; nobody is there to be told.
        sys.stderr.close()
