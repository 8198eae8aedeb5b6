"""All command-line tools end with the same exit statuses, and name the next tool as the user calls it."""

import os
import sys
from collections.abc import Callable

from mrd_base.errors import FaultError, InputError


def command(package: str, tool: str) -> str:
    """Return how to call another tool: as this one was called, by ``ros2 run`` or by ``mrd``.

    Outside of a tool, as in a notebook, the environment decides: that of a ROS workspace names its packages.
    """
    by_mrd = sys.argv[0].startswith("mrd ") or not has_workspace()
    return f"mrd {tool}" if by_mrd else f"ros2 run {package} {tool}"


def has_workspace() -> bool:
    """Return whether the environment is that of a ROS workspace, which has the tools of a bench as well."""
    return "AMENT_PREFIX_PATH" in os.environ


def run_tool(work: Callable[[], None]) -> None:
    """Run the work of a command-line tool and set the exit status of the process.

    The status is 0 on success; 2 after an `InputError` or a file that cannot be read or written, and 3 after a `FaultError`,
    with one line on stderr; and 130 after Ctrl-C.
    """
    # Only a tool that has imported numba compiles. A log needs no word on why it takes longer once.
    if "numba" in sys.modules and sys.stderr.isatty():
        from mrd_base.compiling import tell_when_compiling

        tell_when_compiling()
    try:
        work()
        sys.stdout.flush()
    except InputError as error:
        print(f"error: {error}", file=sys.stderr)
        sys.exit(3 if isinstance(error, FaultError) else 2)
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        sys.exit(130)
    except BrokenPipeError:
        # The reader of the output (``head``, a pager) has closed it. Python would complain when it flushes the rest.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    except OSError as error:
        print(f"error: {error.filename or 'files'}: {error.strerror or error}", file=sys.stderr)
        sys.exit(2)
