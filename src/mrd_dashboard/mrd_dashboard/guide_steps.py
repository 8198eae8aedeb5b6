"""What takes the steps of the guide: the data check, and the jobs of the other tabs."""

from mrd_base import InputError
from mrd_dashboard.dashboard import Dashboard
from mrd_dashboard.guide import Outcome, Step, check_data, damper_to_validate
from mrd_dashboard.jobs import JobRequest
from mrd_identification.fit_file import read_fit


async def check_recordings(dashboard: Dashboard, names: list[str]) -> str:
    """Begin with other recordings, and check them; return what is found.

    Raises
    ------
    InputError
        Without recordings, and while a job of the guide runs.
    """
    guide = dashboard.guide
    if not names:
        raise InputError("no recordings are chosen; choose at least two of different motion")
    if guide.under_way is not None:
        raise InputError(f"the step {guide.under_way[0]} is being computed; wait for its end or cancel it")
    recordings = dashboard.recordings.in_order(names)
    guide.choose([recording.id for recording in recordings])
    chosen = guide.outcomes["data"]
    try:
        found = await dashboard.compute(check_data, [str(recording.path) for recording in recordings])
    except InputError as error:
        if guide.outcomes.get("data") is chosen:
            guide.end("check", Outcome(False, str(error)))
        raise
    if guide.outcomes.get("data") is not chosen:
        raise InputError("other recordings were chosen meanwhile; look at these")
    guide.check(found)
    return guide.outcomes["check"].sentence


def start_step(dashboard: Dashboard, step: Step, *, model: str = "", predicted: list[str] | None = None) -> str:
    """Start the job of a step; return one line.

    Parameters
    ----------
    step : {"fit", "diagnose", "validate"}
    model : str
        Damper model that is fitted, or ``auto``.
    predicted : list of str
        Ids of the recordings that are predicted to validate the damper.

    Raises
    ------
    InputError
        For a step that is not open, while another job runs, and for a validation of what was fitted.
    """
    dashboard.guide.require_open(step)
    job = dashboard.jobs.start(_request(dashboard, step, model, predicted or []))
    dashboard.guide.begin(step, job.folder.name)
    return f"job {job.number} has begun"


def _request(dashboard: Dashboard, step: Step, model: str, predicted: list[str]) -> JobRequest:
    guide, results = dashboard.guide, dashboard.jobs.folder
    fitted = dashboard.recordings.paths(guide.fitted)
    if step == "fit":
        return JobRequest("identify", fitted, model)
    fit = guide.folder(results, "fit")
    name = read_fit(fit / "fit.json").model
    if step == "diagnose":
        return JobRequest("diagnose", fitted, name, parameters=str(fit / "fit.json"), bench=dashboard.bench_file)
    if not predicted:
        raise InputError("no recordings are chosen to be predicted; record one more run within the others, and choose it")
    if again := [run for run in predicted if run in guide.fitted]:
        raise InputError(f"{again[0]} was fitted, so that it shows no prediction; choose recordings that were not")
    damper = damper_to_validate(fit, guide.folder(results, "diagnose"))
    return JobRequest("validate", dashboard.recordings.paths(predicted), name, parameters=str(damper))
