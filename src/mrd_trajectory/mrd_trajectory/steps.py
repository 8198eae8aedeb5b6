"""The steps of a set: files that hold an experiment, or a damper test of several experiments."""

from collections.abc import Sequence
from pathlib import Path

from mrd_base import InputError, from_mapping, read_yaml
from mrd_trajectory.damper_tests import DamperTest, damper_test_type
from mrd_trajectory.experiment import Experiment, format_experiment, parse_experiment, read_experiment
from mrd_trajectory.settings import GeneratorSettings


def is_damper_test(path: str | Path) -> bool:
    """Return whether a file holds a damper test; an unreadable file holds none."""
    try:
        return "test" in read_yaml(path)
    except InputError:
        return False


def read_step(path: str | Path) -> Experiment | DamperTest:
    """Read an experiment, or a damper test by its key ``test``, from a YAML file.

    Raises
    ------
    InputError
        With one line: file, field, what was found and what was expected.
    """
    mapping = read_yaml(path)
    if "test" not in mapping:
        return read_experiment(path)
    try:
        cls = damper_test_type(mapping["test"])
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    return from_mapping(cls, {key: value for key, value in mapping.items() if key != "test"}, str(path))


def experiments_of(step: Experiment | DamperTest, bench: GeneratorSettings) -> Sequence[Experiment]:
    """Return the experiments of a step, in their order.

    Raises
    ------
    InputError
        For a level that the bench does not bear, and for an experiment that its file could not hold.
    """
    if isinstance(step, Experiment):
        return [step]
    return [parse_experiment(format_experiment(one), one.name) for one in step.experiments(bench)]


def read_experiments(path: str | Path, bench: GeneratorSettings) -> Sequence[Experiment]:
    """Read the experiments of a file; see `read_step` and `experiments_of`."""
    step = read_step(path)
    try:
        return experiments_of(step, bench)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
