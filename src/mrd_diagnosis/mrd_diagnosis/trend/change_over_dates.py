"""Find what has changed from the first dates to the last ones, so that it is known which parameter to follow."""

from collections.abc import Mapping, Sequence

from mrd_base.progress import ignore
from mrd_diagnosis.diagnose import diagnose
from mrd_diagnosis.diagnosis import Diagnosis
from mrd_diagnosis.start import Progress
from mrd_diagnosis.trend.calendar import Calendar
from mrd_identification.fit_file import StoredFit
from mrd_runs import Run
from mrd_sim.effects import EFFECTS


def change_over_dates(
    runs: Sequence[Run],
    calendar: Calendar,
    model: str,
    *,
    laws: str | Mapping[str, str] | None = None,
    parameters: StoredFit | None = None,
    seed: int = 0,
    progress: Progress = ignore,
) -> Diagnosis:
    """Explain the difference between the runs of the first and of the last third of the dates.

    Parameters
    ----------
    runs : sequence of Run
    calendar : Calendar
        Dates of the runs.
    model, laws, parameters, seed, progress
        As in `mrd_diagnosis.diagnose`.

    Raises
    ------
    InputError
        For too few dates to follow a parameter over them, and as `mrd_diagnosis.diagnose`.
    """
    calendar.check()
    before, after = calendar.before_and_after(runs)
    return diagnose(after, model, reference=before, laws=laws, parameters=parameters, seed=seed, progress=progress)


def parameter_to_follow(diagnosis: Diagnosis) -> str:
    """Return the first parameter of the effect that explains most of a change, as ``EFFECT.PARAMETER``.

    Empty where no effect explains it, or one that is a change of the model's own parameters.
    """
    if not diagnosis.causes:
        return ""
    effect = EFFECTS[diagnosis.causes[0].effect]
    return "" if effect.only_as_change else f"{effect.id}.{effect.parameters[0].name}"
