"""The simulated bench."""

from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest

from mrd_base import InputError, from_mapping, read_node_parameters
from mrd_sim.damper import Damper
from mrd_sim.effects import EFFECTS
from mrd_sim.motor import MotorConfig
from mrd_sim.plant import DamperConfig, Plant, PlantConfig
from mrd_sim.sensing import MeasuringChain

CONFIG = Path(__file__).resolve().parents[3] / "config" / "plant.yaml"


def started(config=None, **fields):
    """A plant whose motor is ready to move."""
    plant = Plant(config or PlantConfig(**fields))
    plant.advance(0.6)
    plant.motor.feed(b"EIGN(W,0) ZS EL=8000 ADT=1638 VT=655360 ", plant.time)
    plant.advance(0.7)
    return plant


def run(plant, until, step=0.01):
    """Blocks up to a bench time."""
    blocks = []
    while plant.time < until - 1e-9:
        block = plant.advance(min(plant.time + step, until))
        if block is not None:
            blocks.append(block)
    return blocks


def joined(blocks, name):
    return np.concatenate([getattr(block, name) for block in blocks], axis=-1)


def test_the_shipped_file_is_the_default():
    mapping = read_node_parameters(CONFIG, "plant")
    config = from_mapping(PlantConfig, mapping, str(CONFIG))
    shipped, default = config.damper.build(), PlantConfig().damper.build()
    assert shipped.model.names == default.model.names
    assert np.array_equal(shipped.theta, default.theta)
    assert config == PlantConfig(damper=config.damper)


def test_blocks_join_without_a_gap():
    plant = started()
    sequence, time = round(plant.time * 2000), plant.time
    for step in (0.01, 0.0007, 0.05, 0.1):
        block = plant.advance(plant.time + step)
        assert block.sequence == sequence
        assert block.time == pytest.approx(time + 1 / 2000)
        sequence += block.voltage.shape[1]
        time = block.time + (block.voltage.shape[1] - 1) * block.sample_period
        assert time == pytest.approx(plant.time)
        assert len(block.position) == 4 * block.voltage.shape[1]
    assert plant.advance(plant.time + 0.0004) is None


def test_at_bench_times_of_today_nothing_is_lost_to_rounding():
    start = 1.8e9 + 0.123
    plant = Plant(PlantConfig(), start)
    count = sum(block.voltage.shape[1] for block in (plant.advance(start + 0.01 * k) for k in range(1, 101)) if block)
    assert abs(count - 2000) <= 1
    assert plant.time == pytest.approx(start + 1.0, abs=6e-4)


def test_the_rod_moves_and_the_damper_answers():
    plant = started(start_position=-0.008)
    plant.motor.feed(b"MV VT=65536 G ", plant.time)
    blocks = run(plant, 2.5)
    position, velocity = joined(blocks, "position"), joined(blocks, "velocity")
    force, volts = joined(blocks, "force"), joined(blocks, "voltage")
    assert position[0] == pytest.approx(-0.008, abs=1e-5)
    assert velocity[-1] == pytest.approx(0.0050265, rel=1e-3)
    # Past yield: F_y + c0 v + k0 x + f0.
    assert force[-1] == pytest.approx(80 + 900 * velocity[-1] + 1500 * position[-1] - 45, abs=0.5)
    assert volts[0, -200:].mean() == pytest.approx(0.002 + 200 * position[-800:].mean(), abs=0.002)
    assert volts[1, -200:].mean() == pytest.approx(0.005 + 1.002 * force[-800:].mean() * 5 / 980.665, abs=0.002)


def test_coil_command_holds_from_its_time():
    plant = started()
    begin = plant.time
    plant.command_coil(2.5, begin + 0.0331)
    plant.command_coil(5.0, begin - 1.0)
    blocks = run(plant, begin + 0.1)
    current = joined(blocks, "current")
    assert current[0] > 0
    assert current[int(0.0329 * 8000)] == pytest.approx(1.0, abs=1e-6)
    assert current[int(0.0335 * 8000)] < 0.99
    assert current[-1] == pytest.approx(0.5, abs=1e-6)
    with pytest.raises(InputError, match="nan"):
        plant.command_coil(float("nan"), begin)


def test_more_current_more_force():
    forces = []
    for volts in (0.0, 2.5, 5.0):
        plant = started()
        plant.command_coil(volts, 0.0)
        plant.motor.feed(b"MV VT=131072 G ", plant.time)
        forces.append(run(plant, 2.0)[-1].force[-1])
    assert forces[0] < forces[1] < forces[2]


def test_the_same_seed_gives_the_same_volts():
    def volts(seed, step):
        plant = started(seed=seed)
        plant.motor.feed(b"PT=4000 G ", plant.time)
        return joined(run(plant, 1.5, step), "voltage")

    first = volts(1, 0.01)
    np.testing.assert_array_equal(volts(1, 0.01), first)
    assert not np.array_equal(volts(2, 0.01), first)


def test_a_damper_in_blocks_is_the_damper_in_one():
    plant = started()
    plant.command_coil(2.0, 0.0)
    plant.motor.feed(b"PT=9000 G ", plant.time)
    blocks = run(plant, 2.0)
    whole = (
        PlantConfig()
        .damper.build()
        .advance(1 / 8000, *(joined(blocks, name) for name in ("position", "velocity", "acceleration", "current")))
    )
    # Hysteretic state differs at first; after yield it does not.
    np.testing.assert_allclose(joined(blocks, "force")[8000:], whole[8000:], atol=1e-6)


def driven(effects=""):
    """Blocks from the start on: there and back, with steps of the current."""
    plant = Plant(PlantConfig(damper=DamperConfig(effects=effects)))
    for time, volts in ((0.8, 2.5), (1.2, 1.0)):
        plant.command_coil(volts, time)
    blocks = run(plant, 0.6, 0.3)
    plant.motor.feed(b"EIGN(W,0) ZS EL=8000 ADT=1638 VT=655360 ", plant.time)
    blocks += run(plant, 0.7)
    for target, until in ((40000, 1.4), (0, 2.0)):
        plant.motor.feed(b"PT=%d G " % target, plant.time)
        blocks += run(plant, until)
    return blocks


@pytest.fixture(scope="module")
def plain():
    return driven()


def test_neutral_effects_change_nothing(plain):
    found = driven("{" + ", ".join(f"{name}: {{}}" for name, effect in EFFECTS.items() if effect.elongation is None) + "}")
    assert np.array_equal(joined(found, "voltage"), joined(plain, "voltage"))


@pytest.mark.parametrize("effect", EFFECTS.values(), ids=EFFECTS)
def test_an_effect_in_the_plant_is_that_in_the_model(effect, plain):
    """The motion and current that were there, put into the model with the effect, give what the load cell reads."""
    # Less than it takes to reach the usual cap.
    values = {effect.id: dict(effect.typical) | ({"inverse_cap": 5e-3} if effect.id == "cavitation" else {})}
    blocks = driven(str(values))
    own = PlantConfig().damper.build()
    damper = Damper("bouc_wen", dict(zip(own.model.names, own.theta, strict=True)), effects=values)
    motion = [joined(blocks, name) for name in ("position", "velocity", "acceleration", "current")]
    # Within a block, the fluid keeps the temperature that it had at its start.
    starts = [298.15, *(block.temperature[-1] for block in blocks[:-1])]
    motion.append(np.repeat(starts, [len(block.force) for block in blocks]))
    on_rod, measured = damper.forces(1 / 8000, *motion)
    np.testing.assert_allclose(joined(blocks, "force"), on_rod, atol=1e-6)
    # The damper warms up by a tenth of a kelvin in this time.
    least = 0.05 if effect.id == "temperature_dependence" else 0.2
    assert np.max(np.abs(measured - own.advance(1 / 8000, *motion))) > least

    # The same sensors with the same noise.
    config = PlantConfig()
    seed = np.random.SeedSequence(config.seed).spawn(2)[1]
    sensors = [getattr(config.sensors, entry.name) for entry in fields(config.sensors)]
    chain = MeasuringChain(sensors, 8000.0, 4, np.random.default_rng(seed))
    first = 0
    for block in blocks:
        part = slice(first, first + len(block.force))
        first = part.stop
        supply = np.full(len(block.force), config.sensors.current.supply)
        series = block.position, measured[part], block.current, supply, block.acceleration, block.temperature
        read = chain.read(np.stack(series))
        np.testing.assert_allclose(block.voltage, read, atol=1e-8)

    # The motor does not feel what only the sensor does.
    if effect.stage == "sensing":
        assert np.array_equal(motion[0], joined(plain, "position"))
        assert np.array_equal(joined(blocks, "force"), joined(plain, "force"))
    else:
        np.testing.assert_allclose(motion[0], joined(plain, "position"), atol=1e-4)
        assert np.array_equal(motion[3], joined(plain, "current"))


@pytest.mark.parametrize("direction", [-1, 1])
def test_the_rod_cannot_leave_the_stroke(direction):
    plant = started(start_position=direction * 0.02)
    plant.motor.feed(b"MV VT=%d G " % (direction * 131072), plant.time)
    blocks = run(plant, 3.0)
    assert np.max(np.abs(joined(blocks, "position"))) <= 0.0275 + 1e-12
    # The load cell feels the stop up to its amplifier's end.
    assert np.max(direction * joined(blocks, "voltage")[1]) == pytest.approx(10.0, abs=0.01)
    assert not plant.motor.axis.on


def test_jam_holds_the_rod_until_it_is_cleared():
    plant = started()
    plant.motor.feed(b"MV VT=65536 G ", plant.time)
    run(plant, 1.0)
    plant.set_fault("jam", plant.time)
    jammed = run(plant, 1.2)
    assert np.ptp(joined(jammed, "position")) == 0.0
    plant.set_fault("", plant.time)
    assert np.ptp(joined(run(plant, 1.4), "position")) > 0


def test_reset_acts_once():
    plant = started()
    plant.motor.feed(b"BAUD(0)=115200 ", plant.time)
    run(plant, 1.0)
    assert plant.motor.baud == 115200
    plant.set_fault("reset", plant.time)
    assert plant.motor.baud == 9600
    run(plant, 1.6)
    plant.motor.feed(b"BAUD(0)=38400 ", plant.time)
    run(plant, 1.8)
    plant.set_fault("reset", plant.time)
    assert plant.motor.baud == 38400


def test_bad_configurations_are_refused():
    with pytest.raises(InputError, match="unknown fault fire"):
        PlantConfig(fault="fire")
    with pytest.raises(InputError, match="whole fraction"):
        PlantConfig(hardware_rate=3000.0)
    with pytest.raises(InputError, match="within the stroke"):
        PlantConfig(start_position=0.03)
    with pytest.raises(InputError, match="unknown model honey"):
        Plant(PlantConfig(damper=DamperConfig(model="honey")))
    with pytest.raises(InputError, match="stiffness is 'soft'"):
        Plant(PlantConfig(damper=DamperConfig(parameters="stiffness: soft")))
    with pytest.raises(InputError, match=r"damper\.effects: joint_play is 3, expected its parameters"):
        Plant(PlantConfig(damper=DamperConfig(effects="joint_play: 3")))
    with pytest.raises(InputError, match="unknown effect luck"):
        Plant(PlantConfig(damper=DamperConfig(effects="luck: {}")))
    with pytest.raises(InputError, match="unknown parameter sweetness"):
        Plant(PlantConfig(damper=DamperConfig(parameters="sweetness: 1.0")))
    with pytest.raises(InputError, match="nowhere"):
        Plant(PlantConfig(damper=DamperConfig(effects_folder="nowhere")))
    assert isinstance(DamperConfig(parameters=" ").build(), Damper)


@pytest.mark.parametrize("fault", ["overheat", "low_voltage"])
def test_faults_of_the_motor_trip_it(fault):
    plant = started()
    plant.motor.feed(b"MV VT=65536 G ", plant.time)
    run(plant, 1.0)
    assert plant.motor.axis.on
    plant.set_fault(fault, plant.time)
    run(plant, 1.1)
    assert not plant.motor.axis.on


def test_a_pinion_that_slips_leaves_the_rod_behind_for_good():
    plant = started()
    plant.motor.feed(b"MV VT=65536 G ", plant.time)
    begin = joined(run(plant, 1.0), "position")[-1]
    plant.set_fault("slip", plant.time)
    end = joined(run(plant, 2.0), "position")[-1]
    assert end - begin == pytest.approx(0.5 * 0.0050265, rel=0.01)
    plant.set_fault("", plant.time)
    run(plant, 3.0)
    behind = plant.motor.axis.position * plant.config.motor.lead - joined(run(plant, 3.1), "position")[-1]
    assert behind == pytest.approx(0.5 * 0.0050265 - 0.1 * 0.0050265, rel=0.05, abs=6e-4)


def test_a_stuck_encoder_lets_the_rod_run_away_until_the_position_error_trips():
    plant = started()
    plant.motor.feed(b"MV VT=655360 G ", plant.time)
    run(plant, 1.0)
    encoder = plant.motor.axis.position
    plant.set_fault("stuck_encoder", plant.time)
    blocks = run(plant, 1.3)
    assert plant.motor.axis.position == pytest.approx(encoder, abs=1)
    assert np.ptp(joined(blocks, "position")) > 0.005
    assert not plant.motor.axis.on


def test_a_slow_motor_follows_later_until_it_is_mended():
    plant = started()
    plant.motor.feed(b"MV VT=65536 G ", plant.time)
    for fault, lag, until in (("", 0.002, 1.0), ("slow_motor", 0.025, 1.5), ("", 0.002, 2.0)):
        plant.set_fault(fault, plant.time)
        run(plant, until)
        axis = plant.motor.axis
        assert (axis.commanded - axis.position) / axis.velocity == pytest.approx(lag, abs=1e-3)


def test_limit_switches_trip_only_where_they_are_wired():
    for wired in (False, True):
        plant = Plant(PlantConfig(motor=MotorConfig(limit_switches=wired)))
        plant.advance(0.6)
        plant.motor.feed(b"EILP EILN ZS EL=8000 ADT=1638 VT=655360 MV VT=65536 G ", plant.time)
        run(plant, 1.0)
        assert plant.motor.axis.on == wired
        plant.set_fault("touch_limit", plant.time)
        run(plant, 1.1)
        assert not plant.motor.axis.on


@pytest.mark.parametrize(("fault", "sensor"), [("open_coil", 0.0), ("short_coil", 1.0)])
def test_a_broken_coil_has_no_current_whatever_the_sensor_reads(fault, sensor):
    plant = started()
    plant.command_coil(2.5, plant.time)
    assert joined(run(plant, 1.0), "current")[-1] == pytest.approx(0.5, abs=0.01)
    plant.set_fault(fault, plant.time)
    blocks = run(plant, 1.2)
    assert joined(blocks, "current")[-1] == 0.0
    measured = (joined(blocks, "voltage")[2, -100:].mean() - 2.508) / (0.185 * 1.005)
    assert measured == pytest.approx(sensor, abs=0.02)


def test_a_supply_that_leaks_gives_current_without_a_command():
    plant = started()
    plant.set_fault("leak_coil", plant.time)
    assert joined(run(plant, 1.0), "current")[-1] == 0.3
    plant.command_coil(2.5, plant.time)
    assert joined(run(plant, 1.2), "current")[-1] == pytest.approx(0.5, abs=0.01)
    plant.set_fault("", plant.time)
    plant.command_coil(0.0, plant.time)
    assert joined(run(plant, 1.6), "current")[-1] == pytest.approx(0.0, abs=1e-3)


def test_readings_of_broken_channels():
    plant = started()
    voltage = {}
    for fault in ("", "swap_channels", "saturate_force", "disconnect_position", "reverse_force"):
        plant.set_fault(fault, plant.time)
        voltage[fault] = joined(run(plant, plant.time + 0.05), "voltage").mean(axis=1)
    assert voltage["swap_channels"][[0, 1]] == pytest.approx(voltage[""][[1, 0]], abs=0.01)
    assert (voltage["saturate_force"][1], voltage["disconnect_position"][0]) == (10.0, 0.0)
    assert voltage["reverse_force"][1] == pytest.approx(-voltage[""][1], abs=0.01)
