"""All tests of one run share a ROS domain that nobody else uses, and no compiled function is older than its sources."""

from pathlib import Path

import pytest

try:
    from mrd_base.domain import claim_domain
    from mrd_sim import stale_kernels
except ImportError:
    pytest.exit("the packages are not in reach; enter the environment first: . ./env.sh", returncode=2)

claim_domain()
stale_kernels.delete_stale_kernels(Path(stale_kernels.__file__).parent)
