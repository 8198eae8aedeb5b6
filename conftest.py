"""All tests of one run share a ROS domain of their own, whatever the shell says."""

import pytest

try:
    from mrd_base.domain import claim_domain
except ImportError:
    pytest.exit("the packages are not in reach; enter the environment first: . ./env.sh", returncode=2)

claim_domain()
