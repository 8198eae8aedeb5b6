"""Recordings that were processed before they came here: shifted, filtered, interpolated, or with a hum."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from mrd_identification.low_pass import LowPass, describe_low_pass, filter_notes, known_force_filter, moving_average
from mrd_identification.preflight.channels import LOW_RATE, Channel, CheckedRun, milli
from mrd_identification.preflight.finding import Finding, Severity
from mrd_identification.preflight.joins import original_rate
from mrd_identification.preflight.response import PHYSICAL_DELAYS, Response, delay_behind, force_response
from mrd_identification.preflight.spectra import (
    LARGEST_NOISE_OF_POSITION,
    Hum,
    averaged_samples,
    has_notches,
    mains_hum,
    noise_end,
)
from mrd_runs import Run
from mrd_runs.scales import scales_of
from mrd_runs.signals.mains import shows_line
from mrd_sim.effects import EFFECTS

HELD_SHARE = 0.3
"""Share of readings equal to the one before, from which the spectrum of a channel is that of its steps."""
FEWEST_STROKES = 4
"""Strokes of a run, at least, from which its force shows a response to the motion."""
SAME_END = 1.25
"""Ratio of the frequencies at which the noise of two channels ends, up to which the recording was resampled there."""


@dataclass(frozen=True)
class Processing:
    """What was done to a recording, as far as it can be told; neutral where nothing is found.

    Attributes
    ----------
    delay : float
        Delay in s of ``shifted`` against the other channels; negative where it is early.
    shifted : str
        ``force``, ``position``, ``current``, or empty where the delay is that of the force against the motion and nothing
        tells which of the two is shifted.
    surely_early : bool
        Whether no delay explains the recording as well as the advance.
    force_filter, position_filter : LowPass or None
        Low-pass filter of the channel.
    original_rate : float
        Hz, rate at which the recording was sampled before it was interpolated; 0 where it was not.
    interpolated : tuple of str
        Channels that were interpolated linearly. Empty where the recording was resampled in another way.
    hum : Hum or None
        Mains hum of the force.
    """

    delay: float = 0.0
    shifted: str = ""
    surely_early: bool = False
    force_filter: LowPass | None = None
    position_filter: LowPass | None = None
    original_rate: float = 0.0
    interpolated: tuple[str, ...] = ()
    hum: Hum | None = None


def processing_of(run: Run) -> Processing:
    """Return what was done to a recording before it came here.

    Parameters
    ----------
    run : Run

    Returns
    -------
    Processing
        A small delay of the force cannot be told from a lag of the damper or its sensor, and is not given.
    """
    return _processing_of(CheckedRun(run, scales_of([run])))


def _processing_of(checked: CheckedRun) -> Processing:
    run = checked.run
    moves = checked.moves and len(checked.stroke_starts) > FEWEST_STROKES
    known = known_force_filter(run)
    response = force_response(run) if moves and np.ptp(run.force) > 0.0 and not known else Response()
    hum = mains_hum(run.force, run.rate)
    channels = [checked.channels[name] for name in ("position", "force")]
    rates = {channel.name: original_rate(channel, run.rate) for channel in channels if not _is_held(channel)}
    interpolated = tuple(name for name, rate in rates.items() if rate)
    if interpolated:
        return Processing(
            response.delay,
            response.channel,
            response.surely_early,
            original_rate=rates[interpolated[-1]],
            interpolated=interpolated,
            hum=hum,
        )
    force, position = checked.channels["force"], checked.channels["position"]
    windows = [0 if _is_unfit(checked, channel) else averaged_samples(channel.values) for channel in (force, position)]
    # A current that switches after equal times leaves the same comb of notches in the force.
    if windows[0] and checked.current_varies and has_notches(run.current, windows[0]):
        windows[0] = 0
    force_filter = known or response.low_pass
    if windows[0] and not known:
        force_filter = moving_average(windows[0] / run.rate)
        if moves:
            force_filter = moving_average(windows[0] / run.rate, delay_behind(run, force_filter))
        response = Response()
    position_filter = moving_average(windows[1] / run.rate) if windows[1] else None
    ends = [0.0 if _is_unfit(checked, force) else noise_end(force.values, run.rate)]
    ends += [0.0 if _is_unfit(checked, position) else noise_end(position.values, run.rate, LARGEST_NOISE_OF_POSITION)]
    resampled = all(ends) and max(ends) < SAME_END * min(ends) and not force_filter and not position_filter
    if not resampled:
        force_filter = force_filter or (LowPass("unknown", ends[0]) if ends[0] else None)
        position_filter = position_filter or (LowPass("unknown", ends[1]) if ends[1] else None)
    return Processing(
        response.delay,
        response.channel,
        response.surely_early,
        force_filter,
        position_filter,
        2 * float(np.mean(ends)) if resampled else 0.0,
        (),
        hum,
    )


def _is_unfit(checked: CheckedRun, channel: Channel) -> bool:
    """Whether the spectrum of a channel shows its steps or its motion up to the Nyquist frequency, and not noise."""
    return checked.is_slowly_sampled or _is_held(channel)


def _is_held(channel: Channel) -> bool:
    return bool(np.mean(np.diff(channel.values) == 0) > HELD_SHARE)


def check_processing(checked: CheckedRun) -> Iterator[Finding]:
    """Find recordings that are not as their sensors gave them."""
    processing = _processing_of(checked)
    yield from _check_shift(checked, processing)
    if known_force_filter(checked.run):
        yield checked.finding("filter", "remark", "force", f"{filter_notes([checked.run])[0]}.")
    elif processing.force_filter:
        yield _filter_finding(checked, "force", processing.force_filter)
    if processing.position_filter:
        yield _filter_finding(checked, "position", processing.position_filter)
    if processing.original_rate:
        channels = " and ".join(processing.interpolated)
        how = f"{channels} run straight between" if channels else "no channel has noise above half of that"
        text = (
            f"the recording was resampled from about {processing.original_rate:.3g} Hz to {checked.run.rate:.4g} Hz ({how}):"
            " expected the samples of the converter. The noise estimate is too small, and faster effects cannot be seen. "
            "Give the recording at its own rate."
        )
        yield checked.finding("clock", "limitation", (*processing.interpolated, "")[0], text)
    if processing.hum:
        yield _hum_finding(checked, processing.hum)


def _check_shift(checked: CheckedRun, processing: Processing) -> Iterator[Finding]:
    if not processing.delay:
        return
    channel = processing.shifted or "force"
    others = {"force": "motion and current", "position": "force and current", "current": "motion and force"}
    against = others[channel] if processing.shifted else "motion"
    late = "late" if processing.delay > 0 else "early"
    severity: Severity = "fault" if processing.surely_early else "limitation"
    if channel == "force" and late == "late":
        why = (
            f"expected at most {milli(PHYSICAL_DELAYS[1])} ms. No sensor is that late, and no effect of the catalogue "
            "describes it. Shift the force back"
        )
    elif channel == "force":
        why = (
            f"expected no earlier than {milli(-PHYSICAL_DELAYS[0])} ms. No force comes before the motion that causes it. "
            "Either the channels were shifted, or the force was filtered forwards and backwards. Shift the channels back"
        )
    else:
        why = "expected one clock for all channels. The force would answer before its cause. Shift the channel back"
    delay = milli(abs(processing.delay))
    text = f"the {channel} is {delay} ms {late} against {against}: {why}, or give the recording as it was."
    yield checked.finding("lag", severity, channel, text)


def _filter_finding(checked: CheckedRun, channel: str, low_pass: LowPass) -> Finding:
    effect = (
        "Loops are rounded, which a model takes for lag, compliance or hysteresis"
        if channel == "force"
        else "Reversals are rounded, and a velocity computed from it is too small"
    )
    each = " in each direction" if low_pass.kind.startswith("zero_phase") else ""
    advice = "Give the unfiltered recording."
    if channel == "force" and low_pass.word:
        advice = (
            "Give the unfiltered recording; or, if the filter is right, add --force-filter "
            f"{checked.run.name}={low_pass.word}: the modelled force then passes it too."
        )
    text = (
        f"the {channel} has passed {describe_low_pass(low_pass)}, cut-off (-3 dB) at about {low_pass.cutoff:.3g} Hz{each}: "
        f"expected the readings of the sensor. {effect}, and the noise estimate is too small. {advice}"
    )
    return checked.finding("filter", "limitation" if low_pass.cutoff < LOW_RATE / 2 else "remark", channel, text)


def _hum_finding(checked: CheckedRun, hum: Hum) -> Finding:
    largest = EFFECTS["mains_hum"].scaled(checked.scales).parameters[0].upper
    alternates = round(2 * hum.folded / checked.run.rate, 3) == 1.0
    least = "at least " if alternates else ""
    folded = f", which sampling folds to {hum.folded:.3g} Hz" if hum.folded < hum.frequency else ""
    tried = shows_line(hum.frequency, checked.run.rate) and hum.amplitude <= largest and not alternates
    if tried:
        consequence = "The diagnosis tries it as the effect mains_hum."
    elif alternates:
        consequence = "At half the sampling rate, its size depends on its phase: it seems to differ from run to run."
    elif hum.amplitude > largest:
        consequence = f"The effect mains_hum reaches up to {largest:g} N only."
    else:
        consequence = "There it cannot be told from harmonics of the motion, so that the diagnosis does not try it."
    text = (
        f"the force carries a mains hum of {least}{hum.amplitude:.3g} N at {hum.frequency:.3g} Hz{folded} "
        f"({100 * hum.share:.2g} % of the standard deviation of the force): expected none. {consequence} "
        "Check shield and earth of the load cell."
    )
    return checked.finding("hum", "remark" if tried else "limitation", "force", text)
