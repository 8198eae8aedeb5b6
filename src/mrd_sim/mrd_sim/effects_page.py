"""The docs' page about the effects, written from the catalogue."""

from collections.abc import Iterable

from mrd_sim.effects import EFFECTS, STAGES, Effect
from mrd_sim.models_page import clauses
from mrd_sim.parameter import Parameter

COMMAND = "ros2 run mrd_sim effects --markdown > docs/effects.md"

_STAGES = {
    "drive": "from the measured position to that of the damper's rod",
    "magnetics": "from the measured current to the one that acts",
    "fluid": "the damper's force from motion and current",
    "structure": "what the rod meets besides the fluid",
    "sensing": "from the force on the rod to the measured one",
}

_EXAMPLE = '''\
"""Force of a magnet that holds the rod at mid-stroke."""

from numba import njit

from mrd_sim.dual import exp
from mrd_sim.effects import Effect
from mrd_sim.parameter import Parameter


@njit(cache=True, nogil=True)
def _apply(p, state, dt, x, v, a, u, force):
    for k in range(len(x)):
        near = x[k] / p[1]
        force[k] += p[0] * near * exp(-near * near)


EFFECT = Effect(
    id="magnet",
    title="Holding magnet",
    phrase="a magnet holds the rod at mid-stroke with {holding}",
    stage="structure",
    equation="F + F_m y exp(-y²), y = x / l",
    source="my own",
    parameters=(
        Parameter("holding", "N", 0.0, 0.0, 100.0, "force F_m"),
        Parameter("reach", "m", 2e-3, 5e-4, 1e-2, "distance l", log=True),
    ),
    typical={"holding": 30.0, "reach": 2e-3},
    signature="a bump on both sides of mid-stroke",
    confused_with=("gas_spring",),
    separated_by="slow ramps across mid-stroke",
    kernel=_apply,
)
'''


def page() -> str:
    """The page in Markdown: stages, how to switch effects on, the catalogue, and a section for each effect."""
    stages = "\n".join(
        f"| {stage} | {_STAGES[stage]} | {_links(effect.id for effect in catalogue() if effect.stage == stage)} |"
        for stage in STAGES
    )
    rows = "\n".join(
        f"| [`{effect.id}`](#{effect.id}) | {effect.title} | {effect.stage} | "
        f"{', '.join(f'`{p.name}` {interval(p)}' for p in effect.parameters)} |"
        for effect in catalogue()
    )
    sections = "\n".join(section(effect) for effect in catalogue())
    return f"""\
<!-- Written by `{COMMAND}`; changes belong in the catalogue or in effects_page.py. -->

# Effects

What a damper model leaves out and a bench has: an effect is one such thing, in a form that can be put around any damper
model. Switched on in the simulated bench it changes what is recorded; added to the model that is fitted it shows what it
explains. Its first parameter is its size; by default it is 0, and nothing happens.

Each effect belongs to one stage, and the stages follow each other as cause becomes reading; effects of one stage act in the
order of the catalogue below, your own after those. Signs as for the [damper models](models.md): x > 0 extends, F > 0
resists extension. Errors of the position and of the current sensor are written from the measured value to the true one,
because the measured one is what is known.

| stage | what it is | effects |
|---|---|---|
{stages}

## Switching them on

Along an experiment or a recorded motion:

    ros2 run mrd_sim simulate EXPERIMENT.yaml --model bouc_wen --effect seal_friction.coulomb=30 --output with.csv

`--effect` may be repeated; `--effects '{{EFFECT: {{PARAMETER: VALUE}}}}'` is the same in one. In the simulated bench it is
the line `effects` of the damper in `config/plant.yaml`:

    damper:
      effects: "{{seal_friction: {{coulomb: 30.0}}, channel_delay: {{delay: 0.004}}}}"

Fitted with a model (their parameters beside its own, named EFFECT.PARAMETER):

    ros2 run mrd_identification identify RUN... --model bouc_wen --effect seal_friction --output fit

In Python: `Damper("bouc_wen", effects={{"seal_friction": {{"coulomb": 30.0}}}})` (`mrd_sim.damper`), or
`find_model("bouc_wen", effects=["seal_friction"])` (`mrd_sim.models`), a model with parameters such as
`seal_friction.coulomb`.

## Catalogue

| id | effect | stage | parameters (bounds) |
|---|---|---|---|
{rows}

{sections}
## Your own

One file in a folder, named with `--effects-folder FOLDER` (in Python: `mrd_sim.effects.load_effects`). The kernel changes
the signals of its stage in place, sample by sample: `x`, `v`, `a` (drive), `u` (magnetics, the current), `force`. `p` are
the parameters, `state` is carried on from block to block, `dt[0] == 0` begins a path. Functions of `mrd_sim.dual` in place
of `math`'s, and comparisons of `.real`, let it carry the derivatives that a fit needs. An effect that is not neutral at its
parameters' defaults is refused. A report says it in the words of its `phrase`.

```python
{_EXAMPLE}```
"""


def section(effect: Effect) -> str:
    """An effect's equation, parameters, signature and source in Markdown."""
    rows = "\n".join(
        f"| `{p.name}` | {p.unit or '1'} | {_cell(p.meaning)} | {p.default:g} | {interval(p)} | {_typical(effect, p)} |"
        for p in effect.parameters
    )
    return f"""## {effect.id}

**{effect.title}** ({effect.stage})

```text
{chr(10).join(clauses(effect.equation))}
```

| parameter | unit | meaning | neutral | bounds | clearly there |
|---|---|---|---|---|---|
{rows}

- Shows as: {effect.signature}.
- Looks like: {_links(effect.confused_with)}.
- Told apart by: {effect.separated_by}.
- Source: {effect.source}.
{"- Goes on from one run to the next, pauses left out." + chr(10) if effect.carries else ""}"""


def catalogue() -> list[Effect]:
    """All effects in the order of their stages."""
    return sorted(EFFECTS.values(), key=lambda effect: STAGES.index(effect.stage))


def interval(parameter: Parameter) -> str:
    """Bounds, with the unit."""
    fixed = "" if parameter.free else ", fixed unless set"
    return f"{parameter.lower:g} … {parameter.upper:g} {parameter.unit}".rstrip() + fixed


def _typical(effect: Effect, parameter: Parameter) -> str:
    return f"{effect.typical.get(parameter.name, parameter.default):g}"


def _links(names: Iterable[str]) -> str:
    return ", ".join(f"[`{name}`](#{name})" for name in names)


def _cell(text: str) -> str:
    return text.replace("|", "\\|")
