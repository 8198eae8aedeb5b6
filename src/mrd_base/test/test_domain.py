import os
import subprocess
import sys

PROGRAM = "from mrd_base.domain import claim_domain; print(claim_domain(), flush=True); input()"


def test_processes_get_domains_of_their_own():
    """Among them this test run's own, which conftest.py claimed."""
    others = [
        subprocess.Popen([sys.executable, "-c", PROGRAM], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        for _ in range(4)
    ]
    domains = [int(other.stdout.readline()) for other in others]
    for other in others:
        other.communicate("\n", timeout=10)
    assert len({*domains, int(os.environ["ROS_DOMAIN_ID"])}) == 5
    assert all(1 <= domain <= 101 for domain in domains)
