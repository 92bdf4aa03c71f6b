"""Run time of a fit by phase, in milliseconds."""

import pkgutil
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from typing import Any
from unittest.mock import patch

import torch

RENDER_PARTS = {
    "project": ("ewa.project", "disks.project_disks", "sh.shade"),
    "bin": ("tiles.bin_tiles",),
    "raster": ("raster.blend", "raster_disks.blend_disks"),
    "raster backward": ("raster.blend_backward", "raster_disks.blend_disks_backward", "tiles.sum_over_tiles"),
    "project backward": ("ewa_backward.project_backward", "disks.project_disks_backward", "sh.shade_backward"),
}
"""Parts of the CPU renderer, with the functions that are timed for each."""


class Stopwatch:
    """Sums the run time of named phases; does nothing unless ``enabled``.

    Args:
        enabled: whether to measure. On CUDA every phase then ends with a synchronisation.
    """

    def __init__(self, enabled: bool = False) -> None:
        self.enabled = enabled
        self.seconds: dict[str, float] = {}
        self.steps = 0

    @contextmanager
    def phase(self, name: str) -> Iterator[None]:
        """Add the run time of a block to a phase."""
        if not self.enabled:
            yield
            return
        start = _now()
        yield
        self.seconds[name] = self.seconds.get(name, 0.0) + _now() - start

    @contextmanager
    def time_render_parts(self) -> Iterator[None]:
        """Measure the parts of the renderer while the block runs."""
        with ExitStack() as stack:
            if self.enabled:
                for name, functions in RENDER_PARTS.items():
                    for function in functions:
                        target = f"gaussian_enhancer.splat.{function}"
                        stack.enter_context(patch(target, self._wrap(name, target)))
            yield

    def table(self) -> str:
        """Table of milliseconds per step by phase; the renderer's parts are included in render and backward."""
        lines = [f"{'phase':<20}{'ms/step':>9}"]
        for name, seconds in self.seconds.items():
            lines.append(f"{'  ' * (name in RENDER_PARTS) + name:<20}{1e3 * seconds / max(1, self.steps):>9.2f}")
        total = sum(seconds for name, seconds in self.seconds.items() if name not in RENDER_PARTS)
        lines.append(f"{'sum':<20}{1e3 * total / max(1, self.steps):>9.2f}")
        return "\n".join(lines)

    def _wrap(self, name: str, target: str) -> Callable[..., Any]:
        function = pkgutil.resolve_name(target)

        def timed(*args: Any, **kwargs: Any) -> Any:
            with self.phase(name):
                return function(*args, **kwargs)

        return timed


def _now() -> float:
    if torch.cuda.is_available():
        torch.cuda.synchronize()
    return time.perf_counter()
