"""The simulated motor as its host sees it."""

import math

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from mrd_sim.motor import MotorConfig, SmartMotor

READY = "EIGN(W,0) ZS"


class Host:
    """Whoever talks to a motor: sends at the present bench time and waits."""

    def __init__(self, stroke=0.055, **config):
        self.motor = SmartMotor(MotorConfig(**config), stroke=stroke)
        self.time = 0.0
        self.wait(0.5)

    def wait(self, duration):
        """Let time pass; return what arrived."""
        self.time += duration
        self.motor.advance(self.time)
        return bytes(byte for _, byte in self.motor.take_output(self.time))

    def send(self, text, duration=0.1):
        """Send commands and wait."""
        self.motor.feed(text.encode("latin-1") + b"\r", self.time)
        return self.wait(duration)

    def ask(self, query):
        """Answer to one query."""
        reply = self.send(query)
        assert reply.endswith(b"\r")
        assert b"\n" not in reply
        return reply[:-1].decode()

    def rod(self):
        """Positions of the rod in m since last asked."""
        return self.motor.take_motion(self.motor.axis.stored)[0]


@pytest.fixture
def host():
    ready = Host()
    ready.send(READY + " EL=8000 ADT=1638 VT=655360")
    return ready


def test_units(host):
    assert host.ask("RRES") == "8000"
    assert host.ask("RSAMP") == "8000"
    assert host.ask("RSP") == "12500/5.0.3.44"


def test_velocity_and_acceleration_units(host):
    # 65536 is 1 rev/s, 8.192 is 1 rev/s²: 2 rev/s reached after 2 s at 1 rev/s², 8000 counts/rev.
    host.send("MV VT=131072 AT=8 DT=8")
    host.send("G", 1.0 + 2 * 10 / 9600)
    # After a second at 8/8.192 rev/s².
    assert host.motor.axis.commanded == pytest.approx(8000 * 8 / 8.192 / 2, rel=0.001)
    assert host.ask("RB(3,15)") == "0"
    host.wait(2.0)
    assert host.ask("RB(3,15)") == "1"
    first = int(host.ask("RPC"))
    assert int(host.ask("RPC")) - first == pytest.approx(2 * 8000 * 0.1, abs=3)
    assert int(host.ask("RVA")) == pytest.approx(131072, rel=0.01)


def test_odd_accelerations_round_up_to_even(host):
    host.send("MV VT=65536 AT=7 DT=7")
    host.send("G", 0.5)
    other = Host()
    other.send(READY + " EL=8000 ADT=8 MV VT=65536")
    other.send("G", 0.5)
    assert other.motor.axis.commanded == pytest.approx(host.motor.axis.commanded, abs=2)


def test_slower_sampling_rescales_velocities(host):
    host.send("PID4 MV VT=65536 ADT=16380 G", 1.0)
    first = int(host.ask("RPC"))
    assert int(host.ask("RPC")) - first == pytest.approx(0.5 * 8000 * 0.1, abs=1)
    assert host.ask("RSAMP") == "4000"


def test_set_commands_and_errors_are_silent(host):
    assert host.send("PT=5 VT=7 KP=3000 F AMPS=1023 VL=4000 TH=80 MP NONSENSE PT= EL=999999 RW(77)") == b""
    assert host.ask("RBs") == "1"
    assert host.ask("RERRC") == "2"
    assert host.ask("RERRW") == "0"
    host.send("Zs")
    assert host.ask("RBs") == "0"


@pytest.mark.parametrize(
    ("command", "code"),
    [("HELLO", 3), ("rpa", 3), ("EL=999999", 2), ("BAUD(0)=1234", 2), ("VT=", 5), ("RB(0)", 2), ("G", 27)],
)
def test_error_codes(command, code):
    host = Host()
    assert host.send(command) == b""
    assert host.ask("RERRC") == str(code)


@pytest.mark.parametrize("terminator", ["\r", " ", "\n", "\r\n", "  "])
def test_terminators(terminator):
    host = Host()
    host.motor.feed(b"RRES" + terminator.encode(), host.time)
    assert host.wait(0.1) == b"8000\r"


def test_reply_leaves_after_turnaround_at_the_pace_of_the_line():
    host = Host(turnaround=0.004)
    start = host.time
    host.motor.feed(b"RRES ", start)
    host.motor.advance(start + 1.0)
    sent = host.motor.take_output(start + 1.0)
    byte = 10 / 9600
    expected = start + 5 * byte + 0.004 + byte * np.arange(1, 6)
    np.testing.assert_allclose([time for time, _ in sent], expected, atol=1e-9)


def test_a_command_acts_only_when_its_last_byte_is_in():
    host = Host()
    host.send(READY + " ADT=1638 VT=655360 PT=1000")
    host.motor.feed(b"                    G ", host.time)
    host.wait(20 * 10 / 9600)
    assert not host.motor.axis.on
    host.wait(2 * 10 / 9600 + 1e-6)
    assert host.motor.axis.on


def test_boot_buffers_for_half_a_second():
    motor = SmartMotor(MotorConfig(), start=100.0)
    motor.feed(b"RRES ", 100.1)
    motor.advance(100.499)
    assert motor.next_event() == pytest.approx(100.5)
    motor.advance(101.0)
    (first, _), *_ = motor.take_output(101.0)
    assert first == pytest.approx(100.5 + 0.0035 + 10 / 9600)


def test_sticky_addressing():
    host = Host()
    host.send("SADDR3")
    assert host.ask("RADDR") == "3"
    assert host.send("\x81") == b""
    assert host.send("RADDR") == b""
    assert host.send("RADDR") == b""
    assert host.send("\x83RADDR") == b"3\r"
    assert host.send("\x82") == b""
    assert host.send("\x80RADDR") == b"3\r"


def test_echo():
    host = Host()
    assert host.send("ECHO") == b""
    assert host.send("RBe") == b"RBe\r0\r"
    assert host.send("ECHO_OFF") == b"ECHO_OFF\r"
    assert host.send("RBe") == b"0\r"


def test_limit_inputs_hold_the_motor_until_they_are_made_plain():
    host = Host()
    assert int(host.ask("RW(0)")) == 3 | 1 << 10 | 1 << 11 | 1 << 12 | 1 << 13 | 1 << 14 | 1 << 15
    host.send("ADT=1638 VT=655360 PT=1000 G")
    assert host.ask("RPC") == "0"
    host.send("ZS")
    assert host.ask("RBr") == "1"
    host.send("EIGN(W,0)")
    assert int(host.ask("RW(0)")) == 3 | 1 << 12 | 1 << 13
    host.send("ZS")
    assert host.ask("RW(0)") == "3"
    host.send("G", 0.5)
    assert host.ask("RPC") == "1000"


def test_targets_wait_for_g(host):
    host.send("PT=4000", 1.0)
    assert (host.ask("RPA"), host.ask("RBo")) == ("0", "1")
    host.send("G", 1.5)
    assert (host.ask("RPA"), host.ask("RBo"), host.ask("RBt"), host.ask("RMODE")) == ("4000", "0", "0", "1")


def test_zero_velocity_or_acceleration_means_no_motion():
    host = Host()
    host.send(READY + " PT=4000 G", 0.5)
    host.send("VT=65536 G", 0.5)
    host.send("VT=0 ADT=100 G", 0.5)
    assert np.ptp(host.rod()) == 0.0


def test_relative_moves_add_to_the_commanded_position(host):
    host.send("PRT=500 G", 0.5)
    host.send("G", 0.5)
    assert host.ask("RPC") == "1000"
    host.send("PT=100 G", 0.5)
    assert host.ask("RPC") == "100"


def test_g_replans_while_moving(host):
    host.send("PT=20000 VT=131072 ADT=164 G", 0.5)
    assert host.ask("RBt") == "1"
    host.send("PT=-3000 G", 4.0)
    assert (host.ask("RPC"), host.ask("RBt")) == ("-3000", "0")


def test_x_decelerates_and_holds_and_s_stops_at_once(host):
    # 2 rev/s, reached and left at 8.06 rev/s²: a quarter of a second and 1985 counts.
    host.send("MV VT=131072 ADT=66 G", 0.5)
    start = int(host.ask("RPC"))
    assert host.send("X", 0.5) == b""
    host.wait(0.5)
    # The reply to RPC left after its sample was taken: 9 to 20 ms at 16 counts/ms.
    assert 1985 < int(host.ask("RPC")) - start < 1985 + 0.2 * 16000
    assert (host.ask("RBt"), host.ask("RBo")) == ("0", "0")
    host.send("G", 0.5)
    start = int(host.ask("RPC"))
    host.send("S", 0.3)
    stopped = int(host.ask("RPC"))
    assert 0 < stopped - start < 0.11 * 16000
    assert (int(host.ask("RPC")), host.ask("RBt"), host.ask("RBo")) == (stopped, "0", "0")


def test_position_register(host):
    host.send("PT=1000 G", 0.5)
    host.rod()
    host.send("O=250")
    assert (host.ask("RPA"), host.ask("RPT")) == ("250", "1000")
    host.send("OSH=-50")
    assert (host.ask("RPA"), host.ask("RPC")) == ("200", "200")
    assert np.ptp(host.rod()) < 1e-9
    host.send("G", 0.5)
    assert host.ask("RPA") == "1000"


def test_following_error_and_the_way_back(host):
    host.send("EL=500")
    host.motor.axis.jammed = True
    host.send("PT=4000 G", 0.5)
    assert (host.ask("RBe"), host.ask("RBo"), host.ask("RBt")) == ("1", "1", "0")
    host.motor.axis.jammed = False
    host.send("G", 0.5)
    assert (host.ask("RERRC"), host.ask("RBo")) == ("27", "1")
    host.send("ZS")
    assert host.ask("RBe") == "1"
    host.send("OFF ZS")
    assert host.ask("RBe") == "0"
    host.send("PT=100 G", 0.5)
    assert host.ask("RPA") == "100"


@pytest.mark.parametrize(("mode", "off"), [("SLM(1)", "1"), ("SLM(0)", "0")])
def test_software_limits(host, mode, off):
    host.send(f"SLN=-2000 SLP=2000 {mode} SLE PT=30000 G", 2.0)
    assert host.ask("RBo") == off
    assert host.ask("RB(1,12)") == "1"
    assert host.ask("RB(1,14)") == "1"
    assert 2000 < int(host.ask("RPA")) < 2000 + 9000
    host.send("ZS PT=0 G", 2.0)
    assert host.ask("RPA") == "0"
    assert host.ask("RW(1)") == str(1 << 10 | (int(off) << 11))


def test_speed_limit(host):
    host.send("VL=60 PT=30000 G", 1.0)
    assert (host.ask("RBv"), host.ask("RBo")) == ("1", "1")


def test_torque_mode_is_a_share_of_the_voltage():
    host = Host(stroke=math.inf)
    host.send(READY + " MT T=3276 G", 1.0)
    assert host.ask("RMODE") == "4"
    # A tenth of 37 V turns 5100 rpm/48 V * 3.7 V without load.
    assert int(host.ask("RVA")) / 65536 * 60 == pytest.approx(5100 / 48 * 3.7, rel=0.02)
    assert int(host.ask("RTRQ")) == pytest.approx(3276, rel=0.02)


def test_over_temperature_must_cool_before_it_clears(host):
    host.motor.axis.temperature = 90.0
    host.send("")
    assert (host.ask("RBh"), host.ask("RBo"), host.ask("RTEMP")) == ("1", "1", "89")
    host.motor.axis.temperature = 83.0
    host.send("ZS")
    assert host.ask("RBh") == "1"
    host.motor.axis.temperature = 79.0
    host.send("ZS")
    assert host.ask("RBh") == "0"


def test_low_supply_is_a_bus_fault():
    host = Host(supply_voltage=12.0)
    host.send(READY)
    assert host.ask("RB(0,3)") == "1"
    assert host.ask("RB(0,0)") == "0"
    assert int(host.ask("RUJA")) == 12000


@pytest.mark.parametrize("command", ["BAUD(0)=38400", "BAUD38400", "OCHN(RS2,0,N,38400,1,8,C,1000)"])
def test_baud_change_turns_the_rest_into_garbage(command):
    host = Host()
    host.send(command)
    assert host.motor.baud == 38400
    host.motor.feed(b"RRES ", host.time, baud=9600)
    host.motor.advance(host.time + 0.1)
    assert bytes(b for _, b in host.motor.take_output(host.time + 0.1, baud=9600)) != b"8000\r"
    host.time += 0.1
    host.motor.feed(b" \x80 RRES ", host.time, baud=38400)
    host.motor.advance(host.time + 0.1)
    assert bytes(b for _, b in host.motor.take_output(host.time + 0.1, baud=38400)).endswith(b"8000\r")


def test_a_reply_read_at_the_wrong_rate_is_garbage():
    host = Host()
    host.motor.feed(b"RRES ", host.time)
    host.motor.advance(host.time + 0.1)
    assert bytes(b for _, b in host.motor.take_output(host.time + 0.1, baud=115200)) != b"8000\r"


@pytest.mark.parametrize("how", ["Z", "power"])
def test_reset_forgets_everything_and_lets_go(host, how):
    host.send("BAUD(0)=115200")
    host.send("MV VT=65536 G", 0.3)
    assert host.motor.axis.on
    if how == "Z":
        host.send("Z", 0.0)
        host.wait(0.01)
    else:
        host.motor.power_cycle(host.time)
    host.wait(0.6)
    assert host.motor.baud == 9600
    assert not host.motor.axis.on
    # The register starts anew where the rod was when the power came back; it only ran out a little.
    assert host.motor.axis.position > 2000
    assert 0 <= int(host.ask("RPA")) < 500
    host.send("G", 0.2)
    assert not host.motor.axis.on


def test_drop_byte(host):
    host.motor.faults = {"drop_byte"}
    assert len(host.send("RRES")) == 4
    host.motor.faults = set()
    assert host.ask("RRES") == "8000"


def test_damaged_commands(host):
    host.motor.faults = {"damage_command"}
    assert host.send("RRES") == b""
    host.send("MP ADT=100 VT=65536 PT=1000 G", 0.2)
    assert not host.motor.axis.on
    host.motor.faults = set()
    assert host.ask("RRES") == "8000"


def test_duplicated_and_swapped_replies(host):
    host.motor.faults = {"duplicate_reply"}
    assert host.send("RRES") == b"8000\r8000\r"
    host.motor.faults = {"swap_replies"}
    assert host.send("RRES RSAMP RPA") == b"8000\r8000\r"
    assert host.send("RW(0)") == b"3\r0\r"


def test_silence(host):
    host.motor.faults = {"silence"}
    assert host.send("RRES") == b""


def test_garbage(host):
    host.motor.faults = {"garbage"}
    reply = host.send("RRES")
    assert len(reply) == 5
    assert reply != b"8000\r"


@pytest.mark.parametrize(("fault", "delay"), [("late_reply", 0.3), ("split_reply", 0.05)])
def test_late_and_split_replies(host, fault, delay):
    def last_byte():
        start = host.time
        host.motor.feed(b"RRES ", start)
        host.motor.advance(start + 1.0)
        sent = host.motor.take_output(start + 1.0)
        host.time = start + 1.0
        assert bytes(b for _, b in sent) == b"8000\r"
        return sent[-1][0] - start

    normal = last_byte()
    host.motor.faults = {fault}
    assert last_byte() - normal == pytest.approx(delay, abs=1e-6)


# Bytes, and pieces of commands, but never the one letter that starts motion.
WORDS = "PT= PRT= VT= ADT= O= OSH= EL= T= SLP= MP MV MT X S OFF ZS Z SLE BAUD EIGN(W,0) RW( RB( RPA RVA ) , 0 7 -9999"
pieces = st.sampled_from([*WORDS.split(), " ", "\r", "\n"])
noise = st.one_of(
    st.binary(max_size=200).map(lambda data: data.replace(b"G", b"")),
    st.lists(pieces, max_size=60).map(lambda parts: "".join(parts).encode()),
)


@settings(max_examples=150)
@given(noise)
@example(b"RW(\r")
@example(b"O=99999999999999999999999999 OSH=5 Z ")
@example(b"=" * 5000 + b" ")
def test_no_bytes_crash_the_motor_and_only_g_moves_the_rod(data):
    host = Host()
    host.send(READY + " EL=8000 ADT=1638 VT=655360 PT=5000")
    host.motor.feed(data + b"\r", host.time)
    host.wait(10 / 2400 * (len(data) + 2) + 2.0)
    assert np.ptp(host.rod()) == 0.0
    assert not host.motor.axis.on


@settings(max_examples=50)
@given(st.binary(min_size=1, max_size=3).filter(lambda data: not set(data) & set(b"\r\n ")))
def test_a_g_with_anything_attached_is_no_g(data):
    host = Host()
    host.send(READY + " ADT=1638 VT=655360 PT=5000")
    attached = bytes(byte & 0x7F for byte in data)
    if set(attached) & set(b"\r\n "):
        return
    host.motor.feed(b"G" + attached + b"\r" + attached + b"G\r", host.time)
    host.wait(0.5)
    assert np.ptp(host.rod()) == 0.0
