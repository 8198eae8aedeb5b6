"""The command ``mrd`` in the process of the tests: to start Python and to import takes longer than most tools."""

import io
import sys
from contextlib import redirect_stderr, redirect_stdout
from subprocess import CompletedProcess
from unittest.mock import patch

from mrd_cli.cli import mrd


def run_mrd(*arguments: object) -> CompletedProcess[str]:
    """Run ``mrd`` with arguments; return its exit status and what it has printed."""
    out, err, status = io.StringIO(), io.StringIO(), 0
    with patch.object(sys, "argv", ["mrd", *map(str, arguments)]), redirect_stdout(out), redirect_stderr(err):
        try:
            mrd.main()
        except SystemExit as left:
            status = int(left.code or 0)
    return CompletedProcess(arguments, status, out.getvalue(), err.getvalue())
