"""``gaussian-enhancer video_speed``: speed of the job ``video`` relative to its slowest stage alone.

The frames of a path are rendered, enhanced, written and encoded: first each stage alone, with its input in memory,
then all stages together, as the job runs them. The slowest stage alone bounds the speed. Stages share the cores;
"share" is the speed of all together over that bound. Every round begins without references in memory. Reading the
weights and the splat is not counted.
"""

import os
import tempfile
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import torch
from omegaconf import DictConfig

from ablations.study.engine import Study, job
from gaussian_enhancer.align.references import ReferencePool
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.infer.path_references import PathReferences
from gaussian_enhancer.infer.plan import Rules
from gaussian_enhancer.metrics.cost import Timing, time_interleaved
from gaussian_enhancer.runs.compose import compose_job
from gaussian_enhancer.runs.instantiate import build
from gaussian_enhancer.runs.video import VideoOutput, VideoTask, prepare_video, read_output
from gaussian_enhancer.video.encode import VideoWriter
from gaussian_enhancer.video.film import Film, Frame
from gaussian_enhancer.video.frames import FrameFolder

STAGES = ("render", "enhance", "write", "encode")
TOGETHER = "together"


@dataclass(frozen=True)
class Bench:
    """A film that is made repeatedly.

    Args:
        filmed: path, splat and enhancer of the film.
        rules: what may be left out of a frame.
        output: how it is encoded.
        folder: parent of the folders that each repetition writes to.
    """

    filmed: VideoTask
    rules: Rules
    output: VideoOutput
    folder: Path

    def fresh(self, pool: ReferencePool | None = None) -> Film:
        """A film without finished frames and, unless a pool is given, without references in memory."""
        views = self.filmed.validated.pool.views
        validated = replace(self.filmed.validated, pool=ReferencePool(views) if pool is None else pool)
        enhancer = self.filmed.enhancer
        if isinstance(enhancer.reference_config, PathReferences):
            enhancer.reference_config.kept.clear()
        frames_folder = Path(tempfile.mkdtemp(dir=self.folder))
        rendered, planner = self.filmed.task.rendered, validated.planner(self.rules)
        shows_render = self.output.layout.needs_render
        return Film(enhancer, rendered, planner, validated.pool, FrameFolder(frames_folder), shows_render)

    def encode(self, film: Film, frames: Iterable[Frame]) -> None:
        """Encode frames as the job does."""
        if self.output.encoding is None:
            raise InputError("format", "is frames, which are not encoded", "choose mp4 or webm")
        layout, count = self.output.layout, len(film.stored)
        path = film.folder.folder.with_suffix(f".{self.output.encoding.container}")
        with VideoWriter(path, self.output.encoding, *layout.size(*film.size)) as writer:
            for frame in frames:
                writer.write(layout(film.shown_render(frame), frame.enhanced, frame.index / count))


def measured(bench: Bench, rounds: int) -> dict[str, Timing]:
    """Times of a whole film by stage, and of all stages together.

    Args:
        bench: the film.
        rounds: number of rounds, in turn, after one that is not counted.
    """
    pool = ReferencePool(bench.filmed.validated.pool.views, capacity=len(bench.filmed.validated.pool.views))
    drawn = list(bench.fresh(pool).draw_frames())
    frames = list(bench.fresh(pool).enhance_frames(drawn))

    def together() -> None:
        film = bench.fresh()
        bench.encode(film, film)

    calls = {
        "render": lambda: list(bench.fresh().draw_frames()),
        "enhance": lambda: list(bench.fresh(pool).enhance_frames(drawn)),
        "write": lambda: list(bench.fresh().write_frames(frames)),
        "encode": lambda: bench.encode(bench.fresh(), frames),
        TOGETHER: together,
    }
    return time_interleaved(calls, rounds, warm_up=1, device=bench.filmed.enhancer.device)


def summary(times: dict[str, Timing], frames: int) -> dict[str, Any]:
    """Milliseconds a frame by stage and together, and the speed together over that of the slowest stage alone.

    Args:
        times: of a whole film.
        frames: of it.
    """
    milliseconds = {name: times[name].milliseconds / frames for name in (*STAGES, TOGETHER)}
    slowest = max(STAGES, key=lambda name: milliseconds[name])
    return {
        "milliseconds_a_frame": {name: round(value, 2) for name, value in milliseconds.items()},
        "one_after_the_other": round(sum(milliseconds[name] for name in STAGES), 2),
        "slowest": slowest,
        "share": round(milliseconds[slowest] / milliseconds[TOGETHER], 3),
    }


def study(cfg: DictConfig, device: torch.device) -> Study[str]:
    """The film of a run's path.

    Raises:
        InputError: the run or an option of the job ``video`` cannot be used.
    """
    load = os.getloadavg()[0]
    composed = compose_job("video", cfg, cfg.overrides, run=cfg.run, frames=cfg.frames)
    filmed = prepare_video(composed, device)
    output = read_output(composed, filmed.path)
    frames = len(filmed.path.cameras)

    def measure(run: str) -> Iterator[dict[str, object]]:
        with tempfile.TemporaryDirectory() as folder:
            bench = Bench(filmed, build(composed.plan), output, Path(folder))
            times = measured(bench, cfg.rounds)
            height, width = output.layout.size(*bench.fresh().size)
        about = {"run": run, "options": " ".join(cfg.overrides), "frames": frames, "size": f"{width}x{height}"}
        conditions = {"rounds": cfg.rounds, "threads": torch.get_num_threads(), "load_before": round(load, 2)}
        yield {**about, **summary(times, frames), **conditions}

    return Study((Path(cfg.run).name,), measure, ("run", "options", "frames", "size", "threads"), option="run")


run = job(study)
