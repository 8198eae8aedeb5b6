"""Options that several tools share."""

import argparse
from collections.abc import Sequence
from typing import Any

from mrd_sim.effects import load_effects
from mrd_sim.models import load_models


def add_effects_folder(parser: argparse.ArgumentParser) -> None:
    """Add an option that loads a user's own effects; `InputError` when one cannot be used."""
    parser.add_argument(
        "--effects-folder",
        default="",
        action=_LoadEffects,
        metavar="FOLDER",
        help="folder with effects of your own, one a file",
    )


def add_models_folder(parser: argparse.ArgumentParser) -> None:
    """Add an option that loads a user's own damper models; `InputError` when one cannot be used."""
    parser.add_argument(
        "--models-folder",
        default="",
        action=_LoadModels,
        metavar="FOLDER",
        help="folder with damper models of your own, one a file",
    )


class _LoadModels(argparse.Action):
    """Load while the arguments are parsed, as `_LoadEffects`."""

    def __call__(
        self,
        _parser: argparse.ArgumentParser,
        namespace: argparse.Namespace,
        values: str | Sequence[Any] | None,
        _option: str | None = None,
    ) -> None:
        load_models(str(values))
        setattr(namespace, self.dest, str(values))


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
