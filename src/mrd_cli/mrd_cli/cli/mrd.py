"""The command ``mrd``: ``mrd TOOL ARGUMENTS`` runs the same code as ``ros2 run PACKAGE TOOL ARGUMENTS``, without ROS."""

import argparse
import os
import sys
from collections.abc import Callable, Iterable, Mapping
from importlib import import_module
from typing import Any, NamedTuple, NoReturn, cast

import argcomplete
from argcomplete.shell_integration import shellcode

from mrd_base import InputError, run_tool
from mrd_base.config import unknown_key
from mrd_base.version import VERSION


class Tool(NamedTuple):
    """A tool: the module that holds its ``main``, and what it does in a line."""

    module: str
    purpose: str


TOOLS: Mapping[str, Tool] = {
    "import": Tool("mrd_runs.cli.import_", "make bags of recordings in other formats"),
    "info": Tool("mrd_runs.cli.info", "show what recordings hold"),
    "plot": Tool("mrd_identification.cli.plot", "look at recordings, and at what dampers and simulators answer to them"),
    "export_csv": Tool("mrd_runs.cli.export_csv", "write the samples of a bag as a CSV file"),
    "recover": Tool("mrd_runs.cli.recover", "make a readable bag of a damaged one"),
    "characterise": Tool(
        "mrd_characterisation.cli.characterise", "measure forces over speed, energy, response times and gas force"
    ),
    "accept": Tool("mrd_characterisation.cli.accept", "judge a damper by limits or by a golden damper"),
    "batch": Tool("mrd_characterisation.cli.batch", "summarise the tests of many dampers"),
    "identify": Tool("mrd_identification.cli.identify", "fit a damper model to recordings"),
    "compare": Tool("mrd_identification.cli.compare", "fit several damper models and rank them"),
    "validate": Tool("mrd_diagnosis.cli.validate", "predict new runs by a fitted damper or a simulator, without a fit"),
    "diagnose": Tool("mrd_diagnosis.cli.diagnose", "explain the gap between simulator and recordings"),
    "apply": Tool("mrd_diagnosis.cli.apply", "put the cause that a diagnosis named into the simulator"),
    "trend": Tool("mrd_diagnosis.cli.trend", "follow a parameter over dated recordings"),
    "evaluate": Tool("mrd_control.cli.evaluate", "compare control laws around an emulated mechanical system"),
    "review": Tool("mrd_control.cli.review", "compare a recorded hybrid test with its offline twin"),
    "delay": Tool("mrd_control.cli.delay", "measure dead time and lag of the servo in a recorded run"),
    "simulate": Tool("mrd_sim.cli.simulate", "simulate a damper along an experiment or a recording"),
    "export": Tool("mrd_identification.cli.export", "write a fitted damper as C source or FMU"),
    "models": Tool("mrd_sim.cli.models", "list the damper models"),
    "effects": Tool("mrd_sim.cli.effects", "list the effects that may act with a damper model"),
    "preview": Tool("mrd_trajectory.cli.preview", "check an experiment against the limits and show its motion"),
}
"""Tools by name, in the order in which one meets them. Each is imported only when it runs."""

SHELLS = ("bash", "zsh", "fish")


def main() -> None:
    """Entry point of ``mrd``."""
    if "_ARGCOMPLETE" in os.environ:
        _complete(os.environ["COMP_LINE"][: int(os.environ["COMP_POINT"])])
    run_tool(work)


def work() -> None:
    """Run the tool that the first argument names, or answer what the arguments ask about `mrd` itself."""
    name = next(iter(sys.argv[1:]), "--help")
    if name.startswith("-"):
        arguments = _parser().parse_args(sys.argv[1:] or ["--help"])
        print(shellcode(["mrd"], shell=arguments.completion), end="")
        return
    if name not in TOOLS:
        raise InputError(f"unknown tool {unknown_key(name, TOOLS)}")
    sys.argv = [f"mrd {name}", *sys.argv[2:]]
    _main_of(name)()


def _main_of(name: str) -> Callable[[], None]:
    main: Callable[[], None] = import_module(TOOLS[name].module).main
    return main


def _parser() -> argparse.ArgumentParser:
    width = max(map(len, TOOLS))
    parser = argparse.ArgumentParser(
        prog="mrd",
        usage="mrd TOOL [ARGUMENTS]",
        description="Identify dampers from recordings, and explain the gap between simulator and recordings.",
        epilog="\n".join(["tools:", *(f"  {name:{width}}  {tool.purpose}" for name, tool in TOOLS.items())])
        + "\n\nmrd TOOL --help explains a tool.",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="version", version=f"mrd {VERSION}")
    advice = 'print the completion for a shell: eval "$(mrd --completion bash)"'
    parser.add_argument("--completion", choices=SHELLS, required=True, help=advice)
    return parser


def _complete(line: str) -> NoReturn:
    """Print the words that may continue a command line, as argcomplete asks for them in the environment, and exit."""
    words = line.split()
    complete = words if line[-1].isspace() else words[:-1]
    if len(complete) < 2 or complete[1] not in TOOLS:
        parser = _parser()
        parser.add_argument("tool", choices=TOOLS)
        argcomplete.autocomplete(parser, always_complete_options=False)
        sys.exit()
    # The tool makes its own parser: it is taken where it would parse. What it completes begins a word later.
    os.environ["_ARGCOMPLETE"] = str(int(os.environ["_ARGCOMPLETE"]) + 1)
    argparse.ArgumentParser.parse_args = _complete_arguments  # type: ignore[method-assign, assignment]
    _main_of(complete[1])()
    sys.exit()


def _complete_arguments(parser: argparse.ArgumentParser, *_: object) -> NoReturn:
    from mrd_sim.effects import EFFECTS
    from mrd_sim.models import MODELS

    known: dict[str, Iterable[str]] = {"model": MODELS, "models": MODELS, "effect": EFFECTS, "effects": EFFECTS}
    for action in parser._actions:
        if action.dest in known:
            cast(Any, action).completer = _list_completer(known[action.dest])
    argcomplete.autocomplete(parser)
    sys.exit()


def _list_completer(known: Iterable[str]) -> Callable[..., list[str]]:
    """Return a function that completes the last of the names that commas separate."""

    def complete(prefix: str, **_: object) -> list[str]:
        before = prefix[: prefix.rfind(",") + 1]
        return [before + name for name in known]

    return complete


if __name__ == "__main__":
    main()
