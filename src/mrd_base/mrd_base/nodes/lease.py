"""How nodes hear the two topics of the safety concept (docs/safety.md): ``lease`` and ``emergency_stop``."""

import threading
from collections.abc import Callable
from typing import Any

from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

from mrd_base.lease import Lease, LeaseWatch, Mode
from mrd_base.nodes.bench_node import BenchNode, seconds
from mrd_base.nodes.graph import EMERGENCY_STOP, LEASE, SETPOINT
from mrd_interfaces import msg

# Bench time in s between two looks at the age of the lease.
_CHECK_PERIOD = 0.01
# Bench time in s between two warnings of refused setpoints, and between two looks at who sends them.
_WARNING_PERIOD = 1.0
# Who subscribes reliably hears reliable publishers, latched or not, without loss; but never those that send best effort.
_RELIABLE = QoSProfile(depth=10, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.VOLATILE)
_BEST_EFFORT = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT, durability=DurabilityPolicy.VOLATILE)


def hear_emergency_stop(node: BenchNode[Any], callback: Callable[[Any], None], *, raw: bool = False) -> str:
    """Hear ``emergency_stop`` from every publisher, whatever its quality of service; a message may come twice.

    Returns
    -------
    str
        Full name of the topic.
    """
    for qos in (_RELIABLE, _BEST_EFFORT):
        name: str = EMERGENCY_STOP.subscription(node, callback, qos, raw=raw).topic_name
    return name


class LeaseFollower(LeaseWatch):
    """Follows the topic ``lease`` for a node. Any thread may call `check`.

    Parameters
    ----------
    timeout : float
        Age in s from which the lease is void.
    stop : callable
        Stops what the node moves when the supervisor has fallen silent or stopped the bench; receives the reason.
    rest : callable, optional
        Lets rest what the node moves when the bench may move no more, without a fault: the supervisor's request for that may
        be lost.
    """

    def __init__(
        self, node: BenchNode[Any], timeout: float, stop: Callable[[str], object], rest: Callable[[], object] | None = None
    ) -> None:
        super().__init__(timeout)
        self._node, self._stop, self._rest = node, stop, rest
        # Of two threads, one answers the loss of a lease. Nobody holds it while he stops: `stop` may wait for a lock whose
        # holder checks the lease.
        self._lease_lock = threading.Lock()
        self._warned = self._looked = -_WARNING_PERIOD
        self._senders = ""  # of setpoints
        self.refused = ""
        self._news = False  # whether something was refused that `latest_refusal` has not told
        LEASE.subscription(node, self._on_lease)
        node.create_bench_timer(_CHECK_PERIOD, self.check)

    def _on_lease(self, message: msg.Lease) -> None:
        if message.mode not in list(Mode):
            self._warn(f"a lease of {message.holder} is refused: its mode is {message.mode}, expected 0 to {int(max(Mode))}")
            return
        self.check()  # a new supervisor must not hide the loss of the one before
        lease = Lease(
            seconds(message.header.stamp),
            message.holder,
            message.since,
            Mode(message.mode),
            int(message.number),
            message.source,
        )
        with self._lease_lock:
            before = self.lease.mode
            refusal, after = self.renew(lease, self._node.bench.now()), self.lease.mode
        if refusal:
            self._warn(refusal)
        elif before.may_move and after is Mode.FAULT:
            # The message on emergency_stop may be lost; the lease is renewed.
            self._stop("the supervisor has stopped the bench")
        elif self._rest and before.may_move and not after.may_move:
            self._rest()

    def check(self) -> None:
        """Stop if the supervisor has fallen silent while rod or coil may move."""
        with self._lease_lock:
            now, lease = self._node.bench.now(), self.lease
            if not self.is_lost(now):
                return
            self.forget()
        silence = 1e3 * (now - lease.time)
        self._stop(f"the supervisor {lease.holder} has been silent for {silence:.0f} ms; look at its log")

    def permits(self, setpoint: msg.Setpoint) -> bool:
        """Whether a setpoint is to be followed; name the publishers of one that comes from somebody else."""
        number = int(setpoint.lease)
        reason = self.reason_not_to_follow(number, self._node.bench.now())
        if reason and not self.was_granted(number):
            self._warn(f"a setpoint is refused: {reason}; publishers of setpoint: {self._find_senders()}")
        return not reason

    def _find_senders(self) -> str:
        """Return the publishers of setpoints; a fast one must not keep the node busy with looking for them."""
        if (now := self._node.bench.now()) - self._looked > _WARNING_PERIOD:
            self._looked = now
            topics = self._node.get_publishers_info_by_topic(SETPOINT.name)
            self._senders = ", ".join(sorted({f"{info.node_namespace.rstrip('/')}/{info.node_name}" for info in topics}))
        return self._senders

    def latest_refusal(self) -> str:
        """Return the latest refusal of a lease or setpoint since the last call, or ""."""
        news, self._news = self._news, False
        return self.refused if news else ""

    def _warn(self, refusal: str) -> None:
        self.refused, self._news = refusal, True
        if (now := self._node.bench.now()) - self._warned > _WARNING_PERIOD:
            self._warned = now
            self._node.get_logger().warning(refusal)
