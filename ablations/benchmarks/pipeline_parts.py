"""Times of the parts of an enhancement, by a timer around the functions that the enhancement calls.

The pipeline's code is not repeated here: while a timer runs, timed wrappers replace the functions of `PARTS`. The
time of a part does not include that of parts within it.
"""

import functools
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any
from unittest import mock

import torch
from torch import Tensor

from gaussian_enhancer.align import alignment
from gaussian_enhancer.align.references import ReferenceConfig, ReferencePool
from gaussian_enhancer.infer import enhancer
from gaussian_enhancer.infer.change_confidence import ChangeConfidence
from gaussian_enhancer.infer.planner import Planner
from gaussian_enhancer.scene import image_files

PARTS: Mapping[str, tuple[tuple[Any, str], ...]] = {
    "read": ((enhancer, "read_target"), (ReferencePool, "_read"), (ReferencePool, "_read_fine")),
    "plan": ((Planner, "__call__"),),
    "search depth": ((alignment, "refine_depth"), (alignment, "fill_depth")),
    "warp": ((alignment, "reproject"),),
    "check and rank": (
        (alignment, "photometric_difference"),
        (alignment, "hide_inconsistent"),
        (alignment, "reference_weight"),
        (alignment, "rank_references"),
    ),
    "align, the rest": ((ReferenceConfig, "align"),),
    "network": ((enhancer, "enhance_tiled"),),
    "clamp colours": ((enhancer, "clamp_to_references"),),
    "complete colours": ((enhancer, "complete_change"),),
    "confidence": ((ChangeConfidence, "shares"), (enhancer, "apply_shares")),
    "write": ((image_files, "write_image"),),
}
"""Parts in the order in which a view passes through them, and their functions."""
REST = "rest"
"""Time outside of all parts: checks, joins, copies."""
READ = "read"
"""The part that is left out of the time from decoded images on."""


class PartTimer:
    """Milliseconds by part, lap by lap.

    Args:
        device: a CUDA device is synchronised at the start and the end of each part.
    """

    def __init__(self, device: torch.device) -> None:
        self.device = device
        self.laps: dict[str, list[dict[str, float]]] = {}
        self._lap: dict[str, float] = {}
        self._open: list[float] = []

    @contextmanager
    def lap(self, name: str) -> Iterator[None]:
        """Time one run; time outside of all parts counts as `REST`.

        Args:
            name: key under which the run's laps are kept.
        """
        self._lap = dict.fromkeys((*PARTS, REST), 0.0)
        self.laps.setdefault(name, []).append(self._lap)
        with self._part(REST):
            yield

    def around(self, part: str, function: Callable[..., Any]) -> Callable[..., Any]:
        """Wrap a function to time it; outside of a lap the wrapper only calls it."""

        @functools.wraps(function)
        def clocked(*args: Any, **kwargs: Any) -> Any:
            if not self._open:
                return function(*args, **kwargs)
            with self._part(part):
                return function(*args, **kwargs)

        return clocked

    @contextmanager
    def _part(self, part: str) -> Iterator[None]:
        began = self._now()
        self._open.append(0.0)
        try:
            yield
        finally:
            elapsed = self._now() - began
            self._lap[part] += elapsed - self._open.pop()
            if self._open:
                self._open[-1] += elapsed

    def _now(self) -> float:
        if self.device.type == "cuda":
            torch.cuda.synchronize(self.device)
        return 1e3 * time.perf_counter()


@contextmanager
def clocked_parts(timer: PartTimer) -> Iterator[None]:
    """Time the functions of `PARTS` by a timer until the block ends."""
    with ExitStack() as stack:
        for part, places in PARTS.items():
            for owner, name in places:
                clocked = timer.around(part, getattr(owner, name))
                stack.enter_context(mock.patch.object(owner, name, clocked))
        yield


def write_clocked(image: Tensor, path: Path) -> None:
    """Write an image as the job enhance does, by the function that the timer wraps."""
    image_files.write_image(path, image)
