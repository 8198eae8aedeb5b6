"""The docs' page about the effects, written from the catalogue."""

from collections.abc import Iterable
from string import Template

from mrd_sim.effects import EFFECTS, FAULTS, NEEDS, PLACES, STAGES, Effect
from mrd_sim.models_page import clauses
from mrd_sim.parameter import Parameter
from mrd_sim.ranges import RANGES, grows_with

COMMAND = "ros2 run mrd_sim effects --markdown > docs/effects.md"

_STAGES = {
    "drive": "from the measured position to that of the damper's rod",
    "magnetics": "from the measured current to the effective one",
    "fluid": "the damper's force from motion and current",
    "structure": "other forces on the rod",
    "sensing": "from the force on the rod to the measured one",
}

EXAMPLE = '''\
"""Force of a magnet that holds the rod at mid-stroke."""

from numba import njit

from mrd_sim.dual import exp
from mrd_sim.effects import Effect
from mrd_sim.named import named, tuple_type
from mrd_sim.parameter import Parameter
from mrd_sim.ranges import RANGES, grows_with

PARAMETERS = (
    Parameter("holding", "N", 0.0, 0.0, 100.0, "force F_m"),
    Parameter("reach", "m", 2e-3, 5e-4, 1e-2, "distance l", log=True),
)
Parameters = tuple_type("Parameters", __name__, PARAMETERS)


@njit(cache=True, nogil=True)
def _apply(parameters, state, dt, x, v, a, u, force):
    p = named(Parameters, parameters)
    for k in range(len(x)):
        near = x[k] / p.reach
        force[k] += p.holding * near * exp(-near * near)


EFFECT = Effect(
    id="magnet",
    title="Holding magnet",
    phrase="a magnet holds the rod at mid-stroke with {holding}",
    stage="structure",
    equation="F + F_m y exp(-y²), y = x / l",
    source="my measurements",
    parameters=PARAMETERS,
    typical={"holding": 30.0, "reach": 2e-3},
    signature="a bump on both sides of mid-stroke",
    confused_with=("gas_spring",),
    separated_by="slow ramps across mid-stroke",
    shows=("position",),
    kernel=_apply,
)
'''

_PAGE = f"""\
<!-- Written by `{COMMAND}`; changes belong in the catalogue or in effects_page.py. -->

# Effects

An effect is something that a bench has and a damper model leaves out. It can be added to any damper model. Switched on
in the simulated bench, it changes what is recorded. Added to the model that is fitted, it shows how much of the error
it explains. Its first parameter is its size; by default that is 0, and the effect changes nothing.

Each effect belongs to one stage. The stages follow each other in the order in which cause becomes reading. Effects of
one stage act in the order of the catalogue below; your own come after those. Signs are those of the [damper
models](models.md): x > 0 extends, F > 0 resists extension. Errors of the position sensor and of the current sensor are
written from the measured value to the true one, because the measured one is known.

| stage | what it is | effects |
|---|---|---|
$stages

## Switching them on

Along an experiment or a recorded motion:

    ros2 run mrd_sim simulate EXPERIMENT.yaml --model bouc_wen --effect seal_friction.coulomb=30 --output with.csv

`--effect` may be repeated; `--effects '{{EFFECT: {{PARAMETER: VALUE}}}}'` gives all effects at once. In the simulated
bench it is the line `effects` of the damper in `config/plant.yaml`:

    damper:
      effects: "{{seal_friction: {{coulomb: 30.0}}, channel_delay: {{delay: 0.004}}}}"

Fitted with a model, whose parameters then include EFFECT.PARAMETER:

    ros2 run mrd_identification identify RUN... --model bouc_wen --effect seal_friction --output fit

In Python: `Damper("bouc_wen", effects={{"seal_friction": {{"coulomb": 30.0}}}})` (`mrd_sim.damper`), or
`find_model("bouc_wen", effects=["seal_friction"])` (`mrd_sim.models`), a model with parameters such as
`seal_friction.coulomb`.

## Catalogue

| id | effect | stage | parameters (bounds) |
|---|---|---|---|
$effects

{RANGES}$sections
## Your own

Write one file for each effect and name their folder with `--effects-folder FOLDER` (in Python:
`mrd_sim.effects.load_effects`). The kernel changes the signals of its stage in place, sample by sample: `x`, `v`, `a`
(drive), `u` (magnetics, the current), `force`. `parameters` are read by name; `state` is carried on from block to
block; `dt[0] == 0` begins a path.
Write bounds and typical values for the reference damper ([ranges](#ranges)). Use the functions
of `mrd_sim.dual` instead of `math`'s and compare `.real`: then the kernel also carries the derivatives that a fit needs.
Instead of a kernel, an effect may have `coefficients`, which changes the coefficients of the damper model by the measured
temperature, as `temperature_dependence` does.
An effect that is not neutral at its parameters' defaults is
refused. Reports describe the effect with its `phrase`, and compare the place of the error with the places that
`shows` lists, which are any of
$places.
Without `shows`, the effect may show anywhere. `needs` lists what recordings must have to say anything about it ($needs).
`imitated_by` lists the faults of a recording that look like it ($faults); by default, `timing`.

```python
{EXAMPLE}```
"""


def page() -> str:
    """Return the page in Markdown: stages, how to switch effects on, the catalogue, and a section for each effect."""
    stages = "\n".join(
        f"| {stage} | {_STAGES[stage]} | {_links(effect.id for effect in catalogue() if effect.stage == stage)} |"
        for stage in STAGES
    )
    effects = "\n".join(
        f"| [`{effect.id}`](#{effect.id}) | {effect.title} | {effect.stage} | "
        f"{', '.join(f'`{p.name}` {interval(p)}' for p in effect.parameters)} |"
        for effect in catalogue()
    )
    sections = "\n".join(section(effect) for effect in catalogue())
    places = _quoted(PLACES)
    return Template(_PAGE).substitute(
        stages=stages, effects=effects, sections=sections, places=places, needs=_quoted(NEEDS), faults=_quoted(FAULTS)
    )


def _quoted(names: Iterable[str]) -> str:
    return ", ".join(f"`{name}`" for name in names)


def where(effect: Effect) -> str:
    """Return where in recordings the effect must show, in words."""
    return " or ".join(PLACES[place] for place in effect.shows) or "anywhere"


def section(effect: Effect) -> str:
    """Return an effect's equation, parameters, signature and source in Markdown."""
    rows = "\n".join(
        f"| `{p.name}` | {p.unit or '1'} | {_cell(p.meaning)} | {p.default:g} | {interval(p)} | {_typical(effect, p)} "
        f"| {grows_with(p)} |"
        for p in effect.parameters
    )
    return f"""## {effect.id}

**{effect.title}** ({effect.stage})

```text
{chr(10).join(clauses(effect.equation))}
```

| parameter | unit | meaning | neutral | bounds | clearly visible | grows with |
|---|---|---|---|---|---|---|
{rows}

- Shows as: {effect.signature}.
- Where: {where(effect)}.
- Looks like: {_links(effect.confused_with)}.
- Told apart by: {effect.separated_by}.
- Imitated by: {", ".join(FAULTS[fault] for fault in effect.imitated_by) or "no fault of a recording"}.
- Source: {effect.source}.
{chr(10).join(_remarks(effect))}"""


def _remarks(effect: Effect) -> list[str]:
    remarks = [f"- Not seen where {NEEDS[need]}." for need in effect.needs]
    if effect.outlasts_run:
        remarks.append("- Its state continues in the next run; pauses do not count.")
    return [*remarks, ""] if remarks else []


def catalogue() -> list[Effect]:
    """Return all effects in the order of their stages."""
    return sorted(EFFECTS.values(), key=lambda effect: STAGES.index(effect.stage))


def interval(parameter: Parameter) -> str:
    """Return a parameter's bounds with the unit."""
    if parameter.is_constant:
        return f"{parameter.default:g} {parameter.unit}, a constant"
    fixed = "" if parameter.free else ", fixed unless set"
    return f"{parameter.lower:g} … {parameter.upper:g} {parameter.unit}".rstrip() + fixed


def _typical(effect: Effect, parameter: Parameter) -> str:
    return f"{effect.typical.get(parameter.name, parameter.default):g}"


def _links(names: Iterable[str]) -> str:
    return ", ".join(f"[`{name}`](#{name})" for name in names)


def _cell(text: str) -> str:
    return text.replace("|", "\\|")
