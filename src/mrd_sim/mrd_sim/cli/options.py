"""Arguments that the tools share."""

import argparse
from collections.abc import Sequence
from typing import Any

from mrd_sim.effects import load_effects


def add_effects_folder(parser: argparse.ArgumentParser) -> None:
    """A user's own effects, known from there on; `InputError` when one cannot be used."""
    parser.add_argument(
        "--effects-folder", default="", action=_Load, metavar="FOLDER", help="with effects of your own, one a file"
    )


class _Load(argparse.Action):
    def __call__(
        self,
        _parser: argparse.ArgumentParser,
        namespace: argparse.Namespace,
        values: str | Sequence[Any] | None,
        _option: str | None = None,
    ) -> None:
        folder = str(values)
        load_effects(folder)
        setattr(namespace, self.dest, folder)
