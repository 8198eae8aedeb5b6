"""A way to inject the faults that the simulated plant knows."""

from collections.abc import Callable

from faults.campaign import Bench


def in_plant(name: str) -> Callable[[Bench], None]:
    """Return what injects a fault of the plant (`mrd_sim.plant.FAULTS`)."""

    def inject(bench: Bench) -> None:
        bench.set_fault(name)

    return inject
