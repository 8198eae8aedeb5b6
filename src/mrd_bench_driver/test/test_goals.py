"""Goals that no node accepts, and what the client of the bench says then. No node runs here."""

from types import SimpleNamespace
from typing import Any

import pytest

from mrd_base import InputError
from mrd_base.nodes.graph import DIAGNOSE_ON_BENCH, RUN_EXPERIMENT, Action
from mrd_bench_driver.nodes.bench_client import BenchClient


def client_of(answer: Any, refusals: list[str]) -> tuple[BenchClient, Any]:
    client = BenchClient.__new__(BenchClient)
    client._watch, client._refusals = lambda: None, []
    client.spin = lambda until, timeout, *, watch=True: client._refusals.extend(refusals) or until()
    sent = SimpleNamespace(done=lambda: answer is not None, result=lambda: answer)
    return client, SimpleNamespace(send_goal_async=lambda goal, feedback_callback: sent)


@pytest.mark.parametrize(("action", "node"), [(DIAGNOSE_ON_BENCH, "diagnoser"), (RUN_EXPERIMENT, "supervisor")])
def test_a_goal_that_is_not_accepted_names_the_node_of_its_action(action: Action, node: str) -> None:
    client, silent = client_of(None, [])
    with pytest.raises(InputError, match=f"the {node} did not accept the goal within"):
        client._send(action, silent, action.type.Goal(), lambda _: None)
    client, rejecting = client_of(SimpleNamespace(accepted=False), ["run_set: too long"])
    result = client._send(action, rejecting, action.type.Goal(), lambda _: None)
    assert result.message == f"the {node} has rejected the goal; its log tells why"
    client, rejecting = client_of(SimpleNamespace(accepted=False), [f"{action.name}: too long"])
    assert client._send(action, rejecting, action.type.Goal(), lambda _: None).message == "too long"
