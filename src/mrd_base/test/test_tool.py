import signal
import subprocess
import sys

import pytest

from mrd_base import InputError
from mrd_base.tool import command

PROGRAM = """
import sys, time
from mrd_base import FaultError, InputError, run_tool

def refuse():
    raise InputError("a.csv: column force_N is missing")

def doubt():
    raise FaultError("a.csv: the force has the wrong sign")

def write():
    open("/nowhere/out.json", "w")

def wait():
    print("ready", flush=True)
    time.sleep(30)

def chatter():
    for line in range(100_000):
        print("line", line)

works = {"done": lambda: print("done"), "refuse": refuse, "doubt": doubt, "write": write, "wait": wait, "chatter": chatter}
run_tool(works[sys.argv[1]])
"""


@pytest.mark.parametrize(
    ("work", "status", "stdout", "stderr"),
    [
        ("done", 0, "done\n", ""),
        ("refuse", 2, "", "error: a.csv: column force_N is missing\n"),
        ("doubt", 3, "", "error: a.csv: the force has the wrong sign\n"),
        ("write", 2, "", "error: /nowhere/out.json: No such file or directory\n"),
    ],
)
def test_a_tool_ends_with_its_status_and_at_most_one_line(work, status, stdout, stderr):
    tool = subprocess.run([sys.executable, "-c", PROGRAM, work], capture_output=True, text=True)
    assert (tool.returncode, tool.stdout, tool.stderr) == (status, stdout, stderr)


def test_ctrl_c_ends_a_tool_with_130():
    tool = subprocess.Popen(
        [sys.executable, "-c", PROGRAM, "wait"], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    assert tool.stdout.readline() == "ready\n"
    tool.send_signal(signal.SIGINT)
    _, stderr = tool.communicate(timeout=30)
    assert (tool.returncode, stderr) == (130, "interrupted\n")


def test_a_closed_pipe_causes_no_error_message():
    pipeline = ["bash", "-c", '"$@" | head -n 1; exit ${PIPESTATUS[0]}', "bash", sys.executable, "-c", PROGRAM, "chatter"]
    shell = subprocess.run(pipeline, capture_output=True, text=True)
    assert (shell.returncode, shell.stdout, shell.stderr) == (0, "line 0\n", "")


def test_what_was_found_never_breaks_the_line_nor_fills_the_screen() -> None:
    assert str(InputError("name: found si\u2028ne\n")) == "name: found si?ne?"
    assert len(str(InputError("name: found " + 100_000 * "x"))) == 1000


def test_the_next_command_is_typed_as_this_one_was(monkeypatch):
    monkeypatch.setenv("AMENT_PREFIX_PATH", "/opt/ros/jazzy")
    monkeypatch.setattr(sys, "argv", ["/install/mrd_diagnosis/lib/mrd_diagnosis/diagnose"])
    assert command("mrd_diagnosis", "apply") == "ros2 run mrd_diagnosis apply"
    monkeypatch.setattr(sys, "argv", ["mrd diagnose"])
    assert command("mrd_diagnosis", "apply") == "mrd apply"
    monkeypatch.delenv("AMENT_PREFIX_PATH")
    monkeypatch.setattr(sys, "argv", ["/usr/lib/ipykernel_launcher.py"])
    assert command("mrd_diagnosis", "apply") == "mrd apply"
