import os
import subprocess
import sys

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
