"""Order of convergence of the latent sampler: its error by number of steps and schedule."""

import math
from collections.abc import Iterator, Sequence

from ablations.stability.sampler import ddim_errors
from gaussian_enhancer.metrics.records import Record

KIND = "sampler order"
"""Kind of these records."""


def order_records(name: str, steps: Sequence[int], finest: int) -> Iterator[Record]:
    """A record for each number of steps: error against the reference solution.

    Args:
        name: of the schedule.
        steps: numbers of evaluations of the denoiser; may be empty.
        finest: number of steps of the reference solution.
    """
    protocol = f"DDIM in float64, root mean square difference of codes to {finest} steps of the same schedule"
    for count, error in (ddim_errors(name, tuple(steps), finest) if steps else {}).items():
        finite_error = error if math.isfinite(error) else None
        metrics: dict[str, float | None] = {"steps": float(count), "error": finite_error}
        reasons = {} if finite_error is not None else {"error": "the walk diverges"}
        yield Record(KIND, "sampler", name, "float64", "forward", str(count), metrics, reasons, protocol=protocol)


def slopes(records: Sequence[Record]) -> dict[str, float]:
    """By schedule, the order of convergence between the third largest and the largest number of steps.

    An order of 1 means that doubling the steps halves the error.

    Args:
        records: from `order_records`.
    """
    orders: dict[str, float] = {}
    for name in dict.fromkeys(record.scene for record in records):
        points = sorted(
            (steps, error)
            for record in records
            if record.scene == name
            and (steps := record.metrics["steps"]) is not None
            and (error := record.metrics["error"]) is not None
        )
        if len(points) > 2 and points[-1][1] > 0:
            (steps_before, error_before), (last_steps, last_error) = points[-3], points[-1]
            orders[name] = math.log(error_before / last_error) / math.log(last_steps / steps_before)
    return orders
