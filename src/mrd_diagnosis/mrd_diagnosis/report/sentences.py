"""The verdict in words: what was found, how sure it is, how much of the gap it removes, and what to do next."""

import math
import shlex
from collections.abc import Sequence

from mrd_base.tool import command, has_workspace
from mrd_diagnosis.decision.rejection_rules import leaves_open
from mrd_diagnosis.diagnosis import Alternative, AlternativeModel, Cause, Diagnosis, Finding, Gap, HeldOutBy, Rejected
from mrd_diagnosis.evidence.cause_class import class_name
from mrd_diagnosis.localisation.sentence import agreement_sentence, where_sentence
from mrd_diagnosis.recordings.closed_loop import review_commands
from mrd_diagnosis.recordings.imitating_limitations import gap_making_limitations
from mrd_diagnosis.thresholds import THRESHOLDS, is_noise
from mrd_diagnosis.wording.effect_names import STAGE_NAMES, effect_clause, effect_name, effect_names
from mrd_diagnosis.wording.quantities import capitalised, format_error, format_probability, format_share, join_words
from mrd_identification.correction import unproven_effects
from mrd_identification.low_pass import force_filter_arguments
from mrd_runs.read import run_arguments
from mrd_runs.text import named_run
from mrd_sim.effects import EFFECTS
from mrd_sim.own import folder_arguments, model_arguments
from mrd_sim.simulators.recorded import OF_RECORDINGS

MOST = 0.5
"""Share of the gap from which a reader calls it most of it."""

FORM = "speed, recent travel and current"
"""What the form remainder depends on; see `mrd_diagnosis.wrong_form.form_remainder`."""

_PLACEHOLDERS = {
    "PLANT.yaml": "the plant file of your simulator (this workspace has config/plant.yaml)",
    "CORRECTED.yaml": "the plant file to write",
    "RUN...": "the recordings",
    "NEW_RUN": "the new recording",
    "NEW_SIMULATED": "what your simulator answers along the new recording",
    "DIR": "a folder for the reports",
}
"""Words of a command that stand for something of the reader."""


def placeholders(command: str) -> list[str]:
    """Return what the words of a command that stand for something of the reader mean."""
    return [f"{word}: {meaning}" for word, meaning in _PLACEHOLDERS.items() if word in command.split()]


def verdict_sentence(diagnosis: Diagnosis) -> str:
    """Return the verdict in words."""
    gap = diagnosis.gap
    if gap is None:
        return fault_sentence(diagnosis.findings)
    if diagnosis.verdict == "no_gap":
        return _no_change_sentence(gap) if diagnosis.reference else _no_gap_sentence(gap, diagnosis.held_out_by)
    if diagnosis.reference:
        return f"Something has changed since the reference runs. {_gap_sentence(diagnosis, gap)}"
    return _gap_sentence(diagnosis, gap)


def _gap_sentence(diagnosis: Diagnosis, gap: Gap) -> str:
    """Return what explains a gap, or a change, and where it lies."""
    if diagnosis.verdict in ("explained", "ambiguous"):
        sentence = _explained_sentence if diagnosis.verdict == "explained" else _ambiguous_sentence
        parts = (sentence(diagnosis, gap), where_sentence(diagnosis), agreement_sentence(diagnosis))
        return " ".join(filter(None, parts))
    if diagnosis.verdict == "partly_explained":
        return _partly_explained_sentence(diagnosis, gap)
    return _unknown_effect_sentence(diagnosis, gap)


def fault_sentence(findings: Sequence[Finding]) -> str:
    """Return the verdict on faulty recordings: the first fault, and how many more there are."""
    faults = [finding for finding in findings if finding.severity == "fault"]
    place = ", ".join(part for part in (faults[0].run and named_run(faults[0].run), faults[0].channel) if part)
    more = f" ({len(faults) - 1} more {'problem' if len(faults) == 2 else 'problems'} below.)" if len(faults) > 1 else ""
    return f"Data problem{f' ({place})' if place else ''}: {faults[0].text.rstrip('.')}.{more}"


IMITATION_RULES = ("limitation", "clocks")
"""Rules by which an effect is rejected because a limitation of the recordings can imitate it."""


def imitation_note(rejected: Sequence[Rejected]) -> str:
    """Return which effects recordings seem to show that a limitation of these recordings can imitate."""
    names = effect_names([entry.effect for entry in rejected if entry.rule in IMITATION_RULES])
    return (
        f"These recordings look as if the model lacked {names}, but their limitation can imitate that. So no cause is named "
        "before it is mended; runs without it can be diagnosed by themselves."
    )


_LARGER_WHERE = {
    "runs": "on the runs that were set aside, because the fitted ones",
    "leave-one-run-out": "where a whole run is held out, because the others",
    "blocks": "where a segment is held out, because the others",
}
"""Where a model errs by more than noise that has no gap on the fitted data, and what did not determine its parameters."""


def _no_gap_sentence(gap: Gap, held_out_by: HeldOutBy) -> str:
    """Return the verdict that noise explains the error."""
    before, noise = format_error(gap.before.value), format_error(gap.noise_floor.value)
    only_noise = is_noise(gap.before.value, gap.noise_floor.value)
    where = "" if only_noise else f" The error is larger only {_LARGER_WHERE[held_out_by]} do not determine all parameters."
    if gap.as_given is not None and gap.as_given > THRESHOLDS.notable_refit * gap.before.value:
        explains = f"; noise explains that ({noise})" if only_noise else f", the noise is {noise}"
        return (
            f"The parameters caused the gap. With refitted parameters, the error falls from {format_error(gap.as_given)} to "
            f"{before} of the force's standard deviation{explains}.{where}"
        )
    return (
        "No gap beyond the noise. "
        f"The model's error is {before} of the force's standard deviation, the noise is {noise}.{where}"
    )


def _no_change_sentence(gap: Gap) -> str:
    """Return the verdict that nothing has changed."""
    error, floor = format_error(gap.before.value), format_error(gap.noise_floor.value)
    return (
        "No change since the reference runs was found. A model that is the same before and after has an error of "
        f"{error} of the force's standard deviation; a model that may differ between them has {floor}."
    )


def _explained_sentence(diagnosis: Diagnosis, gap: Gap) -> str:
    """Return the verdict that names the causes."""
    text = f"{capitalised(_clauses(diagnosis.causes))} ({_certainty(diagnosis)}).{_removal(diagnosis, gap)}"
    beyond = gap.extrapolated
    share = format_share(beyond.value) if beyond is not None else ""
    if beyond is not None and beyond.value < gap.closed_fraction.lower and share != format_share(gap.closed_fraction.value):
        there = f"this removes only {share}" if beyond.value > 0.0 else "this removes nothing"
        text += f" On the runs that go beyond the others in stroke, speed or current, {there}."
    return text


def _ambiguous_sentence(diagnosis: Diagnosis, gap: Gap) -> str:
    """Return the verdict that several explanations fit nearly as well."""
    if not diagnosis.causes:
        return _seen_sentence(diagnosis, gap)
    certain = [cause for cause in diagnosis.causes if not is_doubted(diagnosis, cause)]
    uncertain = [cause for cause in diagnosis.causes if is_doubted(diagnosis, cause)]
    options: dict[str, Cause | Alternative] = {cause.effect: cause for cause in uncertain}
    for alternative in diagnosis.alternatives:
        # An effect may be an alternative to two causes.
        options.setdefault(alternative.effect, alternative)
    if not diagnosis.alternatives:
        return f"Probably {_clauses(diagnosis.causes)} ({_certainty(diagnosis)}).{_removal(diagnosis, gap)}"
    clauses = [effect_clause(option.effect, option.parameters) for option in options.values()]
    likely = [format_probability(option.probability) for option in options.values()]
    whether = f"these runs do not show whether {join_words(clauses, 'or')} (probabilities {join_words(likely)})."
    if len(uncertain) == 1 and (common := _in_common(uncertain[0])):
        whether = f"{common}: {whether}"
    text = f"{capitalised(_clauses(certain))}. Beyond that, {whether}" if certain else capitalised(whether)
    if math.isfinite(gap.closed_fraction.value):
        share = format_share(gap.closed_fraction.value)
        text += f" The most likely explanation removes {share} of the {_gap_name(diagnosis)}."
    return text


def is_doubted(diagnosis: Diagnosis, cause: Cause) -> bool:
    """Whether another explanation may stand in the place of a cause; of any cause, where an ambiguous verdict lists none."""
    doubted = {alternative.instead_of for alternative in diagnosis.alternatives}
    return diagnosis.verdict == "ambiguous" and (not doubted or cause.effect in doubted)


def _in_common(cause: Cause) -> str:
    """Return what is known of a cause that is not known itself, as a clause; empty where that is nothing."""
    if cause.level == "stage":
        return f"the cause acts in the {STAGE_NAMES[EFFECTS[cause.effect].stage]}"
    name = class_name([member.effect for member in cause.members]) if cause.level == "class" else ""
    return f"{name} (probability {format_probability(cause.class_probability)})" if name else ""


def _seen_sentence(diagnosis: Diagnosis, gap: Gap) -> str:
    """Return the verdict that effects close the gap or come nearest, but with sizes that the recordings do not determine."""
    seen = [entry for entry in diagnosis.rejected if entry.chosen and leaves_open(entry.rule)]
    sentences = [f"Seen, not determined: {join_words([effect_clause(entry.effect, entry.parameters) for entry in seen])}."]
    sentences += [f"{capitalised(effect_name(entry.effect))} is not named as a cause: {entry.why}." for entry in seen]
    if math.isfinite(gap.closed_fraction.value):
        share = format_share(gap.closed_fraction.value)
        sentences.append(f"It would remove {share} of the {_gap_name(diagnosis)}.")
    likely = [f"{effect_name(other.effect)} ({format_probability(other.probability)})" for other in diagnosis.alternatives]
    if likely:
        sentences.append(f"In its place, the cause may be {join_words(likely, 'or')}.")
    if limited := limited_effects(diagnosis):
        first = limited[0]
        sentences.append(
            f"Another effect stands at the limit of its plausible range as well, and may close more beyond it: "
            f"{effect_clause(first.effect, first.parameters)} (removes {format_share(first.closed_fraction.value)})."
        )
    return " ".join(sentences)


def is_seen(diagnosis: Diagnosis) -> bool:
    """Whether an effect comes nearest to the gap that is not named because its size is not determined."""
    return any(entry.chosen and leaves_open(entry.rule) for entry in diagnosis.rejected)


def limited_effects(diagnosis: Diagnosis) -> list[Rejected]:
    """Return the effects that are no part of the best explanation, close much, and stand at the limit of their range."""
    limited = [entry for entry in diagnosis.rejected if entry.rule == "on_bound" and not entry.chosen]
    notable = [entry for entry in limited if entry.closed_fraction.value >= THRESHOLDS.least_share_first]
    return sorted(notable, key=lambda entry: -entry.closed_fraction.value)


def _partly_explained_sentence(diagnosis: Diagnosis, gap: Gap) -> str:
    """Return the verdict that names causes although they do not explain the whole gap, and describes the rest."""
    form = share_of_form(gap)
    form_first, model = form > MOST, notable_model(diagnosis)
    sentences = [_form_headline(form), *([_model_to_try(model)] if model else [])] if form_first else []
    if not form_first and gap.closed_fraction.value < THRESHOLDS.least_share_first:
        sentences = [f"Most of the {_gap_name(diagnosis)} ({format_share(open_share(gap))}) is not explained."]
    beside = "Beside that, " if sentences else ""
    clauses = _clauses(diagnosis.causes)
    sentences.append(
        f"{beside}{clauses if beside else capitalised(clauses)} ({_certainty(diagnosis)}).{_removal(diagnosis, gap)}"
    )
    if seen := [f"{effect_name(entry.effect)} ({entry.why})" for entry in diagnosis.rejected if entry.chosen]:
        sentences.append(f"Seen as well, but not named as a cause: {join_words(seen)}.")
    for cause in diagnosis.causes:
        members = [member.effect for member in cause.members] if cause.level == "class" else []
        others = [
            other for other in diagnosis.alternatives if other.instead_of == cause.effect and other.effect not in members
        ]
        likely = [f"{effect_name(other.effect)} ({format_probability(other.probability)})" for other in others]
        if likely:
            sentences.append(f"In place of {effect_name(cause.effect)}, the cause may be {join_words(likely, 'or')}.")
    if form > THRESHOLDS.notable_share and not form_first:
        sentences.append(
            f"Another {format_share(form)} lies in the form of the damper model: in how its force depends on {FORM}."
        )
    sentences.append(where_sentence(diagnosis, "the remaining error"))
    return " ".join(filter(None, sentences))


def _limitation_headline(limiting: Sequence[Finding]) -> str:
    """Return that a limitation of the recordings makes a gap by itself."""
    runs = list(dict.fromkeys(finding.run for finding in limiting if finding.run))
    where = f" (run{'s' if len(runs) > 1 else ''} {join_words(runs)})" if runs else ""
    return f"A limitation of the recordings makes a gap by itself{where}: {limiting[0].text.rstrip('.')}."


def _form_headline(share: float) -> str:
    """Return that most of a gap lies in the form of the damper model."""
    return (
        f"Most of the gap ({format_share(share)}) lies in the form of the damper model: in how its force depends on {FORM}."
    )


def _model_to_try(model: AlternativeModel) -> str:
    return f"The model {model.name} removes {format_share(model.closed_fraction.value)}: try it next."


def open_share(gap: Gap) -> float:
    """Return the share of the gap that stays open beside the causes."""
    return min(max(1.0 - gap.closed_fraction.value, 0.0), 1.0)


def share_of_form(gap: Gap) -> float:
    """Return the share of the gap that a freer form of the damper would close beside the causes: no more than stays open."""
    return min(gap.form_fraction, open_share(gap))


def _unknown_effect_sentence(diagnosis: Diagnosis, gap: Gap) -> str:
    """Return the verdict that no effect explains the gap, with the best clues."""
    nearest, model = diagnosis.nearest, notable_model(diagnosis)
    in_form = max(0.0, gap.form_fraction, model.closed_fraction.value if model else 0.0)  # nan is no maximum
    tested, untestable, gap_name = _effects_tried(diagnosis), len(diagnosis.untestable), _gap_name(diagnosis)
    if tested:
        cannot = f"; {untestable} more cannot be tested with them" if untestable else ""
        sentences = [f"None of the effects that these runs can test ({tested}) explains the {gap_name}{cannot}."]
    else:
        sentences = [f"These runs cannot test any of the effects ({untestable}) that may explain the {gap_name}."]
    if limiting := gap_making_limitations(diagnosis.findings):
        sentences.insert(0, _limitation_headline(limiting))
        return " ".join(filter(None, [*sentences, where_sentence(diagnosis)]))
    if is_seen(diagnosis):
        sentences = [_seen_sentence(diagnosis, gap)]
    if in_form > MOST:
        sentences.insert(0, _form_headline(in_form))
    if where := where_sentence(diagnosis):
        sentences.append(where)
    if model:
        return " ".join([*sentences, _model_to_try(model)])
    if in_form > MOST or is_seen(diagnosis):
        return " ".join(sentences)
    if nearest is not None and nearest.closed_fraction.value > THRESHOLDS.notable_share:
        verb = "comes" if len(nearest.effects) == 1 else "come"
        share = format_share(nearest.closed_fraction.value)
        names = capitalised(effect_names(nearest.effects))
        sentences.append(f"{names} {verb} nearest: this would remove {share} of the {gap_name}.")
    if gap.form_fraction > THRESHOLDS.notable_share:
        sentences.append(
            f"A freer form of the damper model would remove {format_share(gap.form_fraction)} of the gap: the force depends "
            f"on {FORM} in another way than the model says."
        )
    elif math.isfinite(gap.form_fraction):
        sentences.append(
            f"A freer form of the damper model would remove almost nothing: what is missing depends on more than {FORM}."
        )
    return " ".join(sentences)


def notable_model(diagnosis: Diagnosis) -> AlternativeModel | None:
    """Return the best other damper model if it closes notably more of the gap than the nearest effect."""
    models = () if diagnosis.stand_in else diagnosis.alternative_models
    reached = diagnosis.nearest.closed_fraction.value if diagnosis.nearest is not None else 0.0
    needed = reached + THRESHOLDS.notable_share * (1.0 - reached)
    return models[0] if models and models[0].closed_fraction.value > needed else None


def next_step(diagnosis: Diagnosis) -> str:
    """Return what to do after a verdict; empty where nothing follows. `next_command` has the command for it."""
    add = f"Add {what_was_found(diagnosis)} to your simulator, with the next command."
    unproven = ""
    if _is_doubtful(diagnosis):
        unproven = f", though it is not proven (a probability below {100 * THRESHOLDS.least_probability:g} %)"
        add = f"The next command adds what was found to your simulator{unproven}."
    if diagnosis.verdict == "explained":
        return add
    if diagnosis.verdict == "partly_explained":
        if model := notable_model(diagnosis):
            share = format_share(model.closed_fraction.value)
            return (
                f"Diagnose the runs with the model {model.name} first, by the first command: it removes {share} of the gap "
                "without an effect, and the causes are fitted anew beside it. Apply the result of that. The second command "
                f"adds what was found here to the present model until then{unproven}."
            )
        return f"{add} {steps} Then diagnose all runs again." if (steps := _what_to_record(diagnosis)) else add
    if diagnosis.verdict == "ambiguous" and not diagnosis.causes:
        return _step_to_determine(diagnosis)
    if diagnosis.verdict == "ambiguous":
        advice = diagnosis.next_experiment
        text = advice.text if advice is not None else ""
        if advice is not None and advice.experiment:
            return f"{text} Diagnose all runs again, together with the new one."
        others = ", ".join(dict.fromkeys(alternative.effect for alternative in diagnosis.alternatives))
        other = (
            f" If that shows another one, diagnose the runs again with --effects {others} and apply that." if others else ""
        )
        return (
            f"{text}{other} Until then, the next command applies the most likely explanation, which is not proven.".strip()
        )
    if diagnosis.verdict != "unknown_effect":
        return ""
    if gap_making_limitations(diagnosis.findings):
        return f"{_remedies(diagnosis)} Or leave these runs out. Then diagnose again."
    if model := notable_model(diagnosis):
        return f"Try the model {model.name}."
    if is_seen(diagnosis):
        return _step_to_determine(diagnosis)
    text = ""
    if diagnosis.alternative_models:
        best = diagnosis.alternative_models[0]
        share = format_share(max(best.closed_fraction.value, 0.0))
        text = f"Other damper models were tried and do not explain the gap either: the best one removes {share} of it. "
    if diagnosis.oscillation is not None:
        text += (
            f"Look for the source of {diagnosis.oscillation.label}: record the force with the rod at rest, with the coil "
            "current on and with the drive off, and tap frame and load cell. Record the same motion at half its speed as "
            "well: a frequency that follows the speed comes from the drive, a fixed one from structure or electronics. "
        )
    if steps := _what_to_record(diagnosis):
        return f"{text}{steps} Then diagnose all runs again."
    return f"{text}See where the error lies, and describe the missing effect in a file of your own (docs/effects.md)."


def _step_to_determine(diagnosis: Diagnosis) -> str:
    """Return what to do where effects are seen, but not determined."""
    limited = [entry for entry in diagnosis.rejected if entry.rule == "on_bound" and entry.chosen] + limited_effects(
        diagnosis
    )
    steps = []
    if limited:
        ids = join_words(list(dict.fromkeys(entry.effect for entry in limited)))
        steps.append(
            f"Check whether your rig can have more of it than the plausible range of {ids} allows. If so, declare it "
            "with a wider range in a file of your own (docs/effects.md) and diagnose the runs again."
        )
    if any(entry.rule != "on_bound" for entry in diagnosis.rejected if entry.chosen):
        steps.append(
            "Record runs with other speeds, strokes and currents, which determine the size, and diagnose all together."
        )
    return " ".join(filter(None, [*steps, _remedies(diagnosis)]))


def _is_doubtful(diagnosis: Diagnosis) -> bool:
    """Whether `mrd_identification.correction` takes an effect of the corrected simulator for not proven."""
    effects = diagnosis.corrected.effects if diagnosis.corrected is not None else ()
    return bool(unproven_effects(effects, {cause.effect: cause.probability for cause in diagnosis.causes}))


def next_command(diagnosis: Diagnosis, folder: str = "DIR") -> str:
    """Return the commands that follow from a verdict, one a line; empty where none do. ``folder`` is that of the report."""
    folder, runs = shlex.quote(folder), run_arguments(diagnosis.runs)
    held_out = f" --held-out {run_arguments(diagnosis.held_out)}" if diagnosis.held_out else ""
    reference = f" --reference {run_arguments(diagnosis.reference)}" if diagnosis.reference else ""
    laws = diagnosis.model.laws
    beside = f"{held_out}{reference}{force_filter_arguments((*diagnosis.runs, *diagnosis.held_out, *diagnosis.reference))}"
    diagnose = f"{command('mrd_diagnosis', 'diagnose')} {runs}{beside}"
    again = f"{command('mrd_diagnosis', 'diagnose')} {run_arguments(diagnosis.runs, 'NEW_RUN')}{beside}"
    record = ""
    if diagnosis.next_experiment is not None and diagnosis.next_experiment.experiment and has_workspace():
        record = f"ros2 run mrd_bench_driver bench {folder}/next_experiment.yaml\n"
    if diagnosis.stand_in:
        simulated = " NEW_SIMULATED" if diagnosis.stand_in.name == OF_RECORDINGS else ""
        export = f"{command('mrd_identification', 'export')} {folder}/gap_report.json --output "
        export += "corrected.fmu" if diagnosis.stand_in.name.lower().endswith(".fmu") else "correction.fmu"
        if (
            diagnosis.verdict == "ambiguous"
            and diagnosis.next_experiment is not None
            and diagnosis.next_experiment.experiment
        ):
            return f"{record}{again} --simulator {diagnosis.stand_in.source}{simulated} --output DIR"
        if diagnosis.verdict in ("explained", "partly_explained") and not _is_doubtful(diagnosis):
            return export
        return f"{export} --anyway" if diagnosis.causes else ""
    apply = f"{command('mrd_diagnosis', 'apply')} {folder}/gap_report.json --plant PLANT.yaml --output CORRECTED.yaml"
    apply += folder_arguments()
    corrected = f"{folder}/gap_report.json"
    anyway = f"{apply} --anyway"
    if _is_doubtful(diagnosis):
        # A report that proves nothing is only read by `apply`.
        apply, corrected = anyway, "CORRECTED.yaml"
    reviews = review_commands(diagnosis.runs, corrected)
    if diagnosis.verdict == "explained":
        return "\n".join([apply, *reviews])
    if diagnosis.verdict == "ambiguous" and diagnosis.causes:
        if diagnosis.next_experiment is None or not diagnosis.next_experiment.experiment:
            return anyway
        return f"{record}{again} {model_arguments(diagnosis.model.id, laws)} --output DIR"
    if diagnosis.verdict not in ("partly_explained", "unknown_effect"):
        return ""
    commands = []
    unlimited = diagnosis.verdict == "partly_explained" or not gap_making_limitations(diagnosis.findings)
    if unlimited and (model := notable_model(diagnosis)):
        if model.freed:
            free = " ".join(f"--free {name}" for name in model.freed)
            identify = command("mrd_identification", "identify")
            filters = force_filter_arguments((*diagnosis.runs, *diagnosis.held_out))
            commands.append(f"{identify} {runs}{held_out}{filters} {model_arguments(model.model, laws)} {free} --output DIR")
        else:
            model_and_laws = model_arguments(model.model, model.law)
            commands.append(f"{diagnose} {model_and_laws} --output DIR")
    if diagnosis.verdict == "partly_explained":
        commands += [apply, *reviews]
    return "\n".join(commands)


def _remedies(diagnosis: Diagnosis) -> str:
    """Return what to do about the limitations of the recordings; empty where they have none."""
    return " ".join(dict.fromkeys(finding.remedy for finding in diagnosis.findings if finding.severity == "limitation"))


def _what_to_record(diagnosis: Diagnosis) -> str:
    """Return what to record besides the runs: what mends their limitations, and the advised experiment."""
    advice = diagnosis.next_experiment
    record = "Record next_experiment.yaml, which decides between what is left open." if advice and advice.experiment else ""
    return " ".join(filter(None, [_remedies(diagnosis), record]))


def corrected_label(diagnosis: Diagnosis) -> str:
    """Return what the corrected simulator contains, such as "with the cause"; empty where it contains no effect."""
    found = what_was_found(diagnosis)
    return f"with {found}" if found else ""


def what_was_found(diagnosis: Diagnosis) -> str:
    """Return what the corrected simulator contains, such as "the cause"; empty where it contains no effect."""
    if diagnosis.corrected is None or not diagnosis.corrected.effects:
        return ""
    several = "s" if found_several(diagnosis) else ""
    if diagnosis.verdict in ("explained", "partly_explained"):
        return f"the cause{several}"
    return f"the most likely cause{several}" if _has_likely_causes(diagnosis) else f"the nearest effect{several}"


def found_several(diagnosis: Diagnosis) -> bool:
    """Whether `what_was_found` is several effects."""
    if diagnosis.verdict in ("explained", "partly_explained") or _has_likely_causes(diagnosis):
        return len(diagnosis.causes) != 1
    return diagnosis.corrected is not None and len(diagnosis.corrected.effects) != 1


def _has_likely_causes(diagnosis: Diagnosis) -> bool:
    return diagnosis.verdict == "ambiguous" and bool(diagnosis.causes)


def _clauses(causes: Sequence[Cause]) -> str:
    return join_words([cause_clause(cause) for cause in causes])


def cause_clause(cause: Cause) -> str:
    """Return a cause as a clause: the effect, or what is known of it with the effects among which nothing decides."""
    clause = effect_clause(cause.effect, cause.parameters)
    if cause.level == "stage":
        likeliest = next(iter(cause.plausible), cause.effect)
        if likeliest != cause.effect:
            fitted = f"{effect_name(cause.effect)}, which was fitted ({clause})"
            return f"{_in_common(cause)}, more likely as {effect_name(likeliest)} than as {fitted}"
        return f"{_in_common(cause)}, most likely as {effect_name(cause.effect)} ({clause})"
    if cause.level != "class":
        return clause
    others = [effect_clause(member.effect, member.parameters) for member in cause.members[1:]]
    likely = [format_probability(member.probability) for member in cause.members]
    either = join_words(
        [f"{text} ({probability})" for text, probability in zip([clause, *others], likely, strict=True)], "or"
    )
    name = class_name([member.effect for member in cause.members])
    return f"{name}: either {either}" if name else f"either {either}"


def _effects_tried(diagnosis: Diagnosis) -> int:
    return sum(len(candidate.effects) == 1 for candidate in diagnosis.candidates)


def _certainty(diagnosis: Diagnosis) -> str:
    """Return the probability of the least certain cause in words."""
    least = least_probability(diagnosis)
    bound = "above " if least > 0.99 else "at least " if len(diagnosis.causes) > 1 else ""
    tried = _effects_tried(diagnosis)
    among = f" among the {tried} effects that were tried" if tried > 1 else ", no other effect was tried"
    return f"probability {bound}{'99 %' if least > 0.99 else format_share(least)}{among}"


def least_probability(diagnosis: Diagnosis) -> float:
    """Return the probability of the least certain cause; nan without causes."""
    return min((_probability(cause, diagnosis.alternatives) for cause in diagnosis.causes), default=math.nan)


def _probability(cause: Cause, alternatives: Sequence[Alternative]) -> float:
    """Return the probability of what is named: an effect, a class of them, or those of a stage."""
    if cause.level == "stage":
        stage = EFFECTS[cause.effect].stage
        others = [other for other in alternatives if other.instead_of == cause.effect and other.effect in EFFECTS]
        return cause.probability + sum(other.probability for other in others if EFFECTS[other.effect].stage == stage)
    return cause.class_probability if cause.level == "class" else cause.probability


def _removal(diagnosis: Diagnosis, gap: Gap) -> str:
    """Return the sentence on the removed share; none where the gap is too small beside the noise to know it."""
    if not math.isfinite(gap.closed_fraction.value):
        return ""
    adding = {1: "this effect", 2: "both effects"}.get(len(diagnosis.causes), "these effects")
    if [cause.level for cause in diagnosis.causes] == ["class"]:
        adding = effect_name(diagnosis.causes[0].effect)
    share = format_share(gap.closed_fraction.value)
    return f" Adding {adding} removes {share} of the {_gap_name(diagnosis)}."


def _gap_name(diagnosis: Diagnosis) -> str:
    return "change" if diagnosis.reference else "gap"
