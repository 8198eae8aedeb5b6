import os
import subprocess
import sys

from mrd_base.domain import claim_name, domains_in_use

PROGRAM = "from mrd_base.domain import claim_domain; print(claim_domain(), flush=True); input()"


def test_processes_get_different_domains():
    """The domain of this test run, which conftest.py claimed, is another one as well."""
    processes = [
        subprocess.Popen([sys.executable, "-c", PROGRAM], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        for _ in range(4)
    ]
    domains = [int(process.stdout.readline()) for process in processes]
    for process in processes:
        process.communicate("\n", timeout=10)
    assert len({*domains, int(os.environ["ROS_DOMAIN_ID"])}) == 5
    assert all(1 <= domain <= 101 for domain in domains)


def test_a_domain_with_a_ros_program_that_has_no_lock_is_in_use():
    """A bench that was given its domain, or brought up by hand."""
    program = "import rclpy; rclpy.init(); node = rclpy.create_node('stranger'); print(flush=True); input()"
    domain = next(number for number in range(50, 102) if number not in domains_in_use())
    environment = {**os.environ, "ROS_DOMAIN_ID": str(domain)}
    other = subprocess.Popen(
        [sys.executable, "-c", program], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=environment
    )
    other.stdout.readline()
    assert domain in domains_in_use()
    other.communicate("\n", timeout=10)


def test_a_namespace_of_a_domain_belongs_to_one_process(monkeypatch, tmp_path):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    program = "from mrd_base.domain import claim_name; print(claim_name('/lab/bench') is not None, flush=True); input()"
    environment = {**os.environ, "TMPDIR": str(tmp_path)}
    other = subprocess.Popen(
        [sys.executable, "-c", program], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=environment
    )
    assert other.stdout.readline() == "True\n"
    assert claim_name("lab/bench") is None
    assert claim_name("/lab/bench2") is not None
    other.communicate("\n", timeout=10)
    assert claim_name("/lab/bench") is not None
