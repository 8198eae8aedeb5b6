"""The pseudo-terminal of the simulated motor."""

import os
import threading
import time

import pytest
import serial

from mrd_base import InputError
from mrd_sim.motor import MotorConfig, MotorSerialPort, SmartMotor
from mrd_sim.motor.serial_port import DeviceLink


@pytest.fixture(scope="module", autouse=True)
def compiled():
    """Loading or compiling the motor may take longer than a port waits for a reply."""
    SmartMotor(MotorConfig()).advance(0.01)


@pytest.fixture
def link(tmp_path):
    return tmp_path / "bench" / "motor"


class Line(MotorSerialPort):
    """A serial port whose motor's time is that of the machine."""

    def __init__(self, link):
        super().__init__(SmartMotor(MotorConfig(), start=time.monotonic() - 1.0), link)
        self._ending = threading.Event()
        self._server = threading.Thread(target=self._serve)
        self._server.start()

    def _serve(self):
        while not self._ending.wait(1e-3):
            self.exchange(time.monotonic())

    def close(self):
        self._ending.set()
        self._server.join()
        super().close()


make_line = Line


@pytest.fixture
def line(link):
    made = make_line(link)
    made.plug()
    yield made
    made.close()


def open_port(link, baud=9600):
    return serial.Serial(str(link), baud, timeout=0.5, write_timeout=0.5, exclusive=True)


def ask(port, query):
    port.write(query)
    return port.read_until(b"\r")


def test_the_link_lives_as_long_as_the_line(link):
    line = make_line(link)
    assert not os.path.lexists(link)
    line.plug()
    assert os.readlink(link).startswith("/dev/pts/")
    assert link.parent.stat().st_mode & 0o077 == 0
    line.close()
    assert not os.path.lexists(link)
    line.close()


def test_the_driver_talks_and_may_come_back(line):
    for _ in range(2):
        with open_port(line.link) as port:
            assert ask(port, b"RRES ") == b"8000\r"
            assert ask(port, b"RRES\r") == b"8000\r"


def test_the_line_is_as_slow_as_its_baud_rate(line):
    with open_port(line.link) as port:
        start = time.monotonic()
        assert ask(port, b" " * 91 + b"RRES ") == b"8000\r"
        assert time.monotonic() - start > 101 * 10 / 9600 + 0.0035


def test_rates_that_differ_give_garbage(line):
    with open_port(line.link, 38400) as port:
        assert ask(port, b"RRES ") != b"8000\r"
    with open_port(line.link, 9600) as port:
        port.write(b" \x80 BAUD(0)=115200 ")
        time.sleep(0.05)
        port.baudrate = 115200
        assert ask(port, b"RRES ") == b"8000\r"


def test_bytes_that_are_announced_are_waited_for_and_given_to_the_motor_at_once(link):
    port = MotorSerialPort(SmartMotor(MotorConfig(), start=0.0), link)
    port.plug()
    with open_port(link) as host:
        now = 1.0
        for count in range(1, 200):
            host.write(b"RRES ")
            port.read(5 * count, now)
            while not port.exchange(now, awaited=True):
                now = port.motor.next_event()
            # What has been sent is there: no bench time passes before the host reads it.
            assert host.read(host.in_waiting) == b"8000\r"
        assert now == pytest.approx(1.0 + 199 * (10 * 10 / 9600 + 0.0035))
        begin = time.monotonic()
        port.read(2000, now)
        assert time.monotonic() - begin < 10.0, "bytes that are lost are not waited for for ever"
    port.close()


def test_unplugging_fails_the_driver_and_plugging_in_serves_the_next(line):
    with open_port(line.link) as port:
        ask(port, b"RRES ")
        line.unplug()
        assert not line.plugged
        assert not os.path.lexists(line.link)
        with pytest.raises((serial.SerialException, OSError)):
            ask(port, b"RRES ")
    line.plug()
    with open_port(line.link) as port:
        assert ask(port, b"RRES ") == b"8000\r"


def test_a_driver_that_does_not_read_blocks_nobody(line):
    with open_port(line.link) as port:
        port.write(b"BAUD(0)=115200 ")
        time.sleep(0.05)
        port.baudrate = 115200
        line.motor.config = MotorConfig(turnaround=0.0)
        for _ in range(10):
            port.write(b"RRES " * 100)
        time.sleep(0.6)
        assert line.plugged
        port.reset_input_buffer()
        time.sleep(0.1)
        assert line.plugged


def test_two_motors_do_not_share_a_link(line):
    with pytest.raises(InputError, match="another simulated motor"):
        make_line(line.link)


@pytest.mark.parametrize("kind", ["file", "directory", "link"])
def test_what_is_not_ours_is_not_replaced(tmp_path, kind):
    link = tmp_path / "motor"
    if kind == "file":
        link.write_text("precious")
    elif kind == "directory":
        link.mkdir()
    else:
        link.symlink_to("/dev/null")
    with pytest.raises(InputError, match="something else"):
        make_line(link)
    assert os.path.lexists(link)


def test_a_link_left_by_a_killed_simulator_is_replaced(tmp_path):
    link = tmp_path / "motor"
    link.symlink_to("/dev/pts/4095")
    killed = DeviceLink(link)
    # The link stays after a kill, and the terminal's number may be given to another program.
    other, slave = os.openpty()
    killed.point_to(os.ttyname(slave))
    killed.release()
    assert link.exists()
    line = make_line(link)
    line.plug()
    assert os.readlink(link) == line.terminal != os.ttyname(slave)
    line.close()
    os.close(other)
    os.close(slave)


def test_no_place_for_the_link(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="cannot be made"):
        make_line(tmp_path / "file" / "motor")


def test_reading_after_close_is_an_end_not_a_hang(line):
    port = open_port(line.link)
    line.close()
    with pytest.raises((serial.SerialException, OSError)):
        ask(port, b"RRES ")
    port.close()
