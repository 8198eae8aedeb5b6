"""How every command-line tool ends."""

import os
import sys
from collections.abc import Callable

from mrd_base.errors import InputError


def run_tool(work: Callable[[], None]) -> None:
    """Run ``work`` and leave the process as the tools' contract says.

    Status 0 when done, 2 after `InputError` or a file that cannot be read or written (one line on stderr), 130 after
    Ctrl-C.
    """
    try:
        work()
        sys.stdout.flush()
    except InputError as error:
        print(f"error: {error}", file=sys.stderr)
        sys.exit(2)
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        sys.exit(130)
    except BrokenPipeError:
        # The reader of our output (``head``, a pager) has left: what is still to come goes nowhere, without a complaint.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    except OSError as error:
        print(f"error: {error.filename or 'files'}: {error.strerror or error}", file=sys.stderr)
        sys.exit(2)
