"""How fast the latent sampler's error falls with its steps, by schedule."""

import math
from collections.abc import Iterator, Sequence

from ablations.stability.sampler import order
from gaussian_enhancer.metrics.records import Record

KIND = "sampler order"
"""Kind of these records."""


def measured_order(name: str, steps: Sequence[int], finest: int) -> Iterator[Record]:
    """A record for each number of steps: error against the finest solution.

    Args:
        name: of the schedule.
        steps: evaluations of the denoiser; none gives no record.
        finest: steps of the solution that is compared with.
    """
    protocol = f"DDIM in float64, root mean square difference of codes to {finest} steps of the same schedule"
    for count, error in (order(name, tuple(steps), finest) if steps else {}).items():
        known = error if math.isfinite(error) else None
        metrics: dict[str, float | None] = {"steps": float(count), "error": known}
        reasons = {} if known is not None else {"error": "the walk diverges"}
        yield Record(KIND, "sampler", name, "float64", "forward", str(count), metrics, reasons, protocol=protocol)


def slopes(records: Sequence[Record]) -> dict[str, float]:
    """By schedule, the order of the error between its largest number of steps and the third largest.

    An order of 1 means that twice the steps halve the error.

    Args:
        records: of `measured_order`.
    """
    found: dict[str, float] = {}
    for name in dict.fromkeys(record.scene for record in records):
        points = sorted(
            (steps, error)
            for record in records
            if record.scene == name
            and (steps := record.metrics["steps"]) is not None
            and (error := record.metrics["error"]) is not None
        )
        if len(points) > 2 and points[-1][1] > 0:
            (first, before), (last, after) = points[-3], points[-1]
            found[name] = math.log(before / after) / math.log(last / first)
    return found
