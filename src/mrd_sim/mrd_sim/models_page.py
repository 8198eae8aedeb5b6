"""The docs' page about the damper models, written from the catalogue."""

from string import Template

from mrd_runs.scales import FAR_FROM_ZERO
from mrd_sim.current import LAWS
from mrd_sim.models import MODELS, Coefficient, DamperModel
from mrd_sim.models.model import COIL_LAG, MID_STROKE
from mrd_sim.ranges import RANGES, grows_with

COMMAND = "ros2 run mrd_sim models --markdown > docs/models.md"

_CHOICE = (
    ("a first look at the energy per cycle", "linear_viscous", "has one coefficient and no yield force"),
    (
        "force over speed; a law to invert for control",
        "bingham biviscous",
        "yield force and viscosity as a function of speed alone, without a loop at reversals",
    ),
    (
        "sines about mid-stroke, with their loop over velocity",
        "hyperbolic_tangent algebraic hysteretic_biviscous sigmoid",
        "no state, still easy to invert. The loop comes from the present position or acceleration: models with x fail off "
        "mid-stroke, those with x'' under noise, and all of them in random motion",
    ),
    (
        "a few sines, reproduced closely",
        "polynomial",
        "fits closely, explains nothing, and fails at speeds that were not recorded",
    ),
    (
        "any motion: changing amplitude, off mid-stroke, minor loops, random",
        "bouc_wen normalised_bouc_wen modified_dahl modified_lugre",
        "the state remembers the turning points, as the damper does",
    ),
    (
        "the same, where the force falls off at low speed or an element in series gives way before the fluid yields",
        "modified_bouc_wen shear_thinning_bouc_wen gamota_filisko",
        "a dashpot or springs in series; in the second model the viscosity falls with the speed",
    ),
    ("no damper yet, only a drawing", "quasi_static", "computes the force from geometry and fluid"),
)

EXAMPLE = '''\
"""A Bingham damper whose friction differs between extension and compression."""

from numba import njit

from mrd_sim.dual import tanh
from mrd_sim.models import Coefficient, DamperModel
from mrd_sim.named import named_row, tuple_type

PER_AMPERE = (700.0, 0.0, 4000.0)
COEFFICIENTS = (
    Coefficient("friction_out", "f_e", "N", "friction, extending", 120.0, 0.0, 2000.0, per_ampere=PER_AMPERE),
    Coefficient("friction_in", "f_c", "N", "friction, compressing", 80.0, 0.0, 2000.0, per_ampere=PER_AMPERE),
    Coefficient("viscous", "c", "N s/m", "viscosity", 1000.0, 0.0, 1e4),
    Coefficient("creep_speed", "v_e", "m/s", "speed at which friction is 76 % developed", 2e-3, 2e-3, 2e-3, free=False),
)
Coefficients = tuple_type("Coefficients", __name__, COEFFICIENTS)


@njit(cache=True, nogil=True)
def _force(q, state, dt, x, v, a, force):
    for k in range(len(x)):
        c = named_row(Coefficients, q, k)
        friction = c.friction_out if v[k].real > 0.0 else c.friction_in
        force[k] = friction * tanh(v[k] / c.creep_speed) + c.viscous * v[k]


MODEL = DamperModel(
    id="asymmetric_bingham",
    title="Asymmetric Bingham",
    equation="F = f tanh(x' / v_e) + c x', f = f_e for x' > 0 and f_c for x' < 0",
    source="my measurements",
    coefficients=COEFFICIENTS,
    kernel=_force,
    odd=False,
)
'''
"""A model of one's own; a test loads it and computes its force."""

_PAGE = f"""\
<!-- Written by `{COMMAND}`; changes belong in the catalogue or in models_page.py. -->

# Damper models

A damper model gives the force on the rod from its motion and the coil current. The position x is 0 at mid-stroke and
grows as the damper extends; x' is the velocity, x'' the acceleration. The force F is positive where it resists
extension, so that F x' > 0 is dissipated power. Gas pressure pushes the rod out and is a negative offset f0. Units are
SI: m, s, N, A.

Every model has the constant `{MID_STROKE.name}`, the reading of the position sensor at mid-stroke. It is 0 by default.
Where the middle of the recorded strokes is more than {FAR_FROM_ZERO:g} times half the stroke away from 0, as with a sensor
that counts from elsewhere, a fit or a diagnosis sets it to this middle and says so.

`ros2 run mrd_sim models` lists the models, `ros2 run mrd_sim models MODEL` shows one with its parameters, and
`ros2 run mrd_identification identify RUN... --model MODEL` fits one to recordings.

## Which one

| recorded or wanted | start with | because |
|---|---|---|
$choice

Which of them describes a damper best can only be judged on recordings that were not fitted:
`ros2 run mrd_identification compare` ranks the models that way.

## Catalogue

| id | model | parameters | memory | integration | passive |
|---|---|---|---|---|---|
$models

- Parameters: their number with the model's default current laws.
- Memory: whether the force depends on the motion before.
- Integration: exact along a path of straight pieces between samples and reversals, or the order with which the error
  falls with the step.
- Passive: whether no closed cycle at constant current can yield energy, as long as the coefficients at that current are
  within their bounds.

## Current

The effective current u follows the measured current I with a lag, u' = (I - u) / {COIL_LAG.name}; every model has this
parameter ($lag). The current law of a coefficient p says how p depends on u. Each coefficient has a law by default and
may be given another (`identify RUN... --law LAW` for all, `--law COEFFICIENT=LAW,...` for each):

| law | p over u | parameters of the coefficient NAME |
|---|---|---|
$laws

p0 is the value at 0 A and p1 the slope there, whatever the law. A coefficient in which the force is not linear stays at
the least value that any damper may have where its law would take it below.

{RANGES}$sections
## Your own

Write one file for each model and name their folder with `--models-folder FOLDER`, before or after `--model ID` (in a plant
file and in goals of actions: `models_folder`; in Python: `mrd_sim.models.load_models`). The kernel fills the force, sample
by sample.
Write bounds for the reference damper ([ranges](#ranges)), and a number in the kernel that has a unit as a coefficient
whose bounds are its default: then both follow the scales of any damper. `q` holds the coefficients at the current of
each sample, which are read by name; `state` is carried on from block to block; `dt[0] == 0` begins a path. Use the
functions of `mrd_sim.dual` instead of `math`'s and compare `.real`: then the kernel also carries the derivatives that a
fit needs.
What scales the viscous or the yield part of the force says so by `part`, for the effect `temperature_dependence`; without
it, coefficients in N s/m and Pa s count as viscous, and those in N, but for a constant force, as yield.

A model is tried when it is loaded. One whose force or derivative is not finite within the bounds is refused. So is one that
lacks a property that it claims: `odd` (turning the motion round turns the force round) and `dissipative` (no closed cycle
yields energy). The line says which, and what to write where it is meant.

    mrd identify RUN... --models-folder my_models --model asymmetric_bingham --output DIR

```python
{EXAMPLE}```
"""


def page() -> str:
    """Return the page in Markdown: how to choose, the current laws, the catalogue, and a section for each model."""
    choice = "\n".join(
        f"| {wanted} | {', '.join(f'[`{name}`](#{name})' for name in names.split())} | {reason} |"
        for wanted, names, reason in _CHOICE
    )
    laws = "\n".join(
        f"| {law.id} | `{law.equation.removeprefix('p = ')}` | `NAME`"
        + (", `NAME_per_A`" if law.code else "")
        + (f", `NAME{law.third}`" if law.third else "")
        + " |"
        for law in LAWS.values()
    )
    models = "\n".join(
        f"| [`{model.id}`](#{model.id}) | {model.title} | {sum(not p.place for p in model.parameters)} | {memory(model)} "
        f"| {integration(model)} | {'yes' if model.dissipative else 'no'} |"
        for model in MODELS.values()
    )
    sections = "\n".join(section(model) for model in MODELS.values())
    lag = f"{COIL_LAG.lower:g} … {COIL_LAG.upper:g} s; a simulated damper has none unless it is given one"
    return Template(_PAGE).substitute(choice=choice, models=models, lag=lag, laws=laws, sections=sections)


def section(model: DamperModel) -> str:
    """Return a model's equation, coefficients and source in Markdown."""
    rows = "\n".join(_row(coefficient) for coefficient in model.coefficients)
    text = f"""## {model.id}

**{model.title}**

```text
{chr(10).join(clauses(model.equation))}
```

| coefficient | | unit | meaning | at 0 A: default (bounds) | current law: slope at 0 A (bounds) | grows with |
|---|---|---|---|---|---|---|
{rows}

"""
    if model.observables:
        names = model.observables(model.at_current(model.defaults, 0.0))
        text += f"Recordings determine, and fits report: {', '.join(f'`{name}`' for name in names)}.\n\n"
    return f"{text}Source: {model.source}.\n"


def clauses(equation: str) -> list[str]:
    """Split an equation at the commas outside of brackets; each part keeps its comma."""
    parts, depth = [""], 0
    for character in equation:
        depth += (character == "(") - (character == ")")
        parts[-1] += character
        if character == "," and depth == 0:
            parts.append("")
    return [part.strip() for part in parts]


def memory(model: DamperModel) -> str:
    """Say whether the force depends on the motion before: yes or no."""
    return "yes" if model.states else "no"


def integration(model: DamperModel) -> str:
    """Say how exact the integration is."""
    return f"order {model.order}" if model.order else "exact"


def bounds(coefficient: Coefficient) -> str:
    """Return a coefficient's default and bounds at 0 A."""
    if coefficient.lower == coefficient.upper:
        return f"{coefficient.default:g}, a constant"
    fixed = "" if coefficient.free else ", fixed unless set"
    return f"{coefficient.default:g} ({coefficient.lower:g} … {coefficient.upper:g}{fixed})"


def slope(coefficient: Coefficient) -> str:
    """Return a coefficient's default current law, with default and bounds of the slope at 0 A."""
    if coefficient.per_ampere is None:
        return "–"
    default, lower, upper = coefficient.per_ampere
    if coefficient.law == "constant":
        return f"constant; with another law {default:g} ({lower:g} … {upper:g})"
    return f"{coefficient.law}: {default:g} ({lower:g} … {upper:g})"


def _row(coefficient: Coefficient) -> str:
    meaning = coefficient.meaning.replace("|", "\\|")
    return (
        f"| `{coefficient.name}` | {coefficient.symbol} | {coefficient.unit or '1'} | {meaning} | {bounds(coefficient)} "
        f"| {slope(coefficient)} | {grows_with(coefficient.parameters()[0])} |"
    )
