"""All effects that a plant may have, one file and one line each, in the order of their places.

Each has several formulas; those of the development family and those of the evaluation family have nothing in common. The
effects that the catalogue lacks are last.
"""

from importlib import import_module

from mrd_trials.truth.effects.true_effect import EffectParameter, Family, Formula, TrueEffect

EFFECTS: dict[str, TrueEffect] = {
    name: import_module(f"mrd_trials.truth.effects.{name}").EFFECT
    for name in (
        "servo_ripple",
        "backlash",
        "current_sensor_error",
        "magnetic_hysteresis",
        "current_saturation",
        "coil_lag",
        "gas_spring",
        "cavitation",
        "flow_asymmetry",
        "shear_thinning",
        "rate_dependent_hysteresis",
        "thermal_fade",
        "settling",
        "series_compliance",
        "bypass_flow",
        "joint_play",
        "seal_friction",
        "side_load_friction",
        "hardening_spring",
        "end_stop",
        "moving_mass",
        "lvdt_nonlinearity",
        "load_cell_drift",
        "force_sensor_lag",
        "channel_delay",
        "mains_hum",
        "channel_crosstalk",
        "frame_resonance",
        "orifice_loss",
        "tapered_gap",
        "field_stiffness",
        "air_bubble",
        "supply_ripple",
        "thixotropy",
        "sensor_stiction",
        "guide_waviness",
        "cell_overload",
        "gain_drift",
    )
}
"""Effects by id."""

__all__ = ["EFFECTS", "EffectParameter", "Family", "Formula", "TrueEffect"]
