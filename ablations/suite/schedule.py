"""Predicts how long a plan takes on several workers: list scheduling of its graph, the longest runnable run first.

That is also the order in which dask receives the runs. A run is not split between workers. Cost measurements come last,
one after another, since they need an otherwise idle machine.
"""

import heapq
from collections.abc import Sequence

from ablations.suite.plan import PlannedRun


def predicted_minutes(steps: Sequence[PlannedRun], workers: int) -> float:
    """Minutes until all unfinished runs of a plan are made.

    Args:
        steps: the plan; a run's inputs come before it.
        workers: number of runs that are made at once, at least 1.
    """
    unfinished = [step for step in steps if step.state.name != "done"]
    alone = sum(step.minutes for step in unfinished if step.work.job == "cost")
    return _makespan([step for step in unfinished if step.work.job != "cost"], workers) + alone


def _makespan(steps: Sequence[PlannedRun], workers: int) -> float:
    """Time at which the last of the runs ends."""
    position = {step.name: index for index, step in enumerate(steps)}
    waits = [{position[name] for name in step.inputs if name in position} for step in steps]
    needed_by: list[list[int]] = [[] for _ in steps]
    for index, inputs in enumerate(waits):
        for needed in inputs:
            needed_by[needed].append(index)
    ready = [(-step.minutes, index) for index, step in enumerate(steps) if not waits[index]]
    heapq.heapify(ready)
    running: list[tuple[float, int]] = []
    now = 0.0
    while ready or running:
        while ready and len(running) < workers:
            _, index = heapq.heappop(ready)
            heapq.heappush(running, (now + steps[index].minutes, index))
        now, ended = heapq.heappop(running)
        for index in needed_by[ended]:
            waits[index].discard(ended)
            if not waits[index]:
                heapq.heappush(ready, (-steps[index].minutes, index))
    return now
