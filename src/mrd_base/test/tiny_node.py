"""A node with nothing to do, for the tests."""

from dataclasses import dataclass

from mrd_base import InputError, quantity
from mrd_base.nodes.bench_node import BenchNode, run_node


@dataclass(frozen=True)
class RodLimits:
    stroke: float = quantity(0.055, "mm", "travel of the damper", lower=1e-3, upper=1)
    force: float = quantity(800.0, "N")


@dataclass(frozen=True)
class TinySettings:
    limits: RodLimits = RodLimits()
    port: str = quantity("/dev/ttyUSB0", doc="serial line")
    gains: tuple[float, ...] = quantity((1.0, 2.0))
    offset: float | None = quantity(None, "mm")
    rate: float = quantity(25.0, "Hz", lower=1, upper=2000)
    count: int = quantity(0, lower=0)


class TinyNode(BenchNode[TinySettings]):
    """Does nothing, but does it well."""

    dynamic = frozenset({"rate_hz"})

    def __init__(self) -> None:
        super().__init__("tiny", TinySettings)
        self.hardware_id = "tiny 7"
        self.accept_parameter("rate_hz", self.config.rate, self.set_rate)
        print(self.config, flush=True)

    def set_rate(self, rate: float) -> None:
        if rate % 5:
            raise InputError(f"rate_hz: found {rate:g}, expected a multiple of 5")
        print("rate", rate, flush=True)

    def warning(self) -> str:
        return "the port is loose" if self.config.port == "loose" else ""

    def health(self) -> tuple[str, dict[str, object]]:
        return ("the port is gone" if self.config.port == "gone" else ""), {}

    def close(self) -> None:
        print("closed", flush=True)


if __name__ == "__main__":
    run_node(TinyNode)
