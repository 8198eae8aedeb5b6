"""Options that several tools share."""

import argparse
from collections.abc import Sequence
from typing import Any

from mrd_sim.effects import load_effects


def add_effects_folder(parser: argparse.ArgumentParser) -> None:
    """Add an option that loads a user's own effects; `InputError` when one cannot be used."""
    parser.add_argument(
        "--effects-folder",
        default="",
        action=_LoadEffects,
        metavar="FOLDER",
        help="folder with effects of your own, one a file",
    )


class _LoadEffects(argparse.Action):
    """Load while the arguments are parsed, so that later arguments may name the effects."""

    def __call__(
        self,
        _parser: argparse.ArgumentParser,
        namespace: argparse.Namespace,
        values: str | Sequence[Any] | None,
        _option: str | None = None,
    ) -> None:
        load_effects(str(values))
        setattr(namespace, self.dest, str(values))
