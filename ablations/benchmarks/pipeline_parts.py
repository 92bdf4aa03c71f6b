"""Which part of an enhancement takes how long: a stopwatch around the functions that the enhancement calls.

Nothing of the pipeline is repeated here. While a stopwatch runs, the functions of `PARTS` are replaced by themselves
with a clock around them; a part's time does not hold that of a part within it.
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
from gaussian_enhancer.align.references import Pool, ReferenceConfig
from gaussian_enhancer.infer import enhancer
from gaussian_enhancer.infer.change_confidence import ChangeConfidence
from gaussian_enhancer.infer.planner import Planner
from gaussian_enhancer.scene import image_files

PARTS: Mapping[str, tuple[tuple[Any, str], ...]] = {
    "read": ((enhancer, "read_target"), (Pool, "_read"), (Pool, "_read_fine")),
    "plan": ((Planner, "__call__"),),
    "search depth": ((alignment, "refine_depth"), (alignment, "fill_depth")),
    "warp": ((alignment, "reproject"),),
    "check and rank": (
        (alignment, "photometric_difference"),
        (alignment, "hide_inconsistent"),
        (alignment, "reference_weight"),
        (alignment, "rank"),
    ),
    "align, the rest": ((ReferenceConfig, "align"),),
    "network": ((enhancer, "enhance_tiled"),),
    "clamp colours": ((enhancer, "clamp_to_references"),),
    "complete colours": ((enhancer, "complete_change"),),
    "confidence": ((ChangeConfidence, "forward"),),
    "write": ((image_files, "write_image"),),
}
"""Parts in the order in which a view passes through them, and the functions that do them."""
REST = "rest"
"""What no part holds: checks, joins, copies."""
READ = "read"
"""The part that is left out of the time from decoded images on."""


class Stopwatch:
    """Milliseconds by part, lap by lap.

    Args:
        device: is waited for whenever a part begins or ends, if it is CUDA.
    """

    def __init__(self, device: torch.device) -> None:
        self.device = device
        self.laps: dict[str, list[dict[str, float]]] = {}
        self._lap: dict[str, float] = {}
        self._open: list[float] = []

    @contextmanager
    def lap(self, name: str) -> Iterator[None]:
        """One run of a whole; what no part takes is `REST`.

        Args:
            name: of the whole, under which its laps are kept.
        """
        self._lap = dict.fromkeys((*PARTS, REST), 0.0)
        self.laps.setdefault(name, []).append(self._lap)
        with self._part(REST):
            yield

    def around(self, part: str, function: Callable[..., Any]) -> Callable[..., Any]:
        """A function with the clock around it; outside of a lap it is itself."""

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
def clocked_parts(stopwatch: Stopwatch) -> Iterator[None]:
    """Let a stopwatch clock the functions of `PARTS` until the block ends."""
    with ExitStack() as stack:
        for part, places in PARTS.items():
            for owner, name in places:
                clocked = stopwatch.around(part, getattr(owner, name))
                stack.enter_context(mock.patch.object(owner, name, clocked))
        yield


def write_clocked(image: Tensor, path: Path) -> None:
    """Write an image as the job enhance does, where the stopwatch sees it."""
    image_files.write_image(path, image)
