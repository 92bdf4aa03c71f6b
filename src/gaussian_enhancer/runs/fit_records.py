"""Records of a fitted run: the quality of its held-out renders, and its cost."""

import statistics
from collections.abc import Sequence
from pathlib import Path

from gaussian_enhancer.metrics.image_folders import Label, measure_files, pair_folders
from gaussian_enhancer.metrics.records import Record, read_records, write_records
from gaussian_enhancer.runs.run import Run
from gaussian_enhancer.scene.scene import Scene


def write_fit_records(
    job: Run, scene: Scene, method: str, steps: Sequence[int], seconds: float | None, count: int
) -> None:
    """Write the quality of each held-out render, measured on its 8-bit file, and the cost of the run.

    Args:
        job: the run whose folder holds the renders.
        scene: the scene that was fitted.
        method: name of the splat's method.
        steps: training steps after which views were rendered.
        seconds: duration of the run; None if it was interrupted, since only the last part was timed.
        count: number of Gaussians.

    Raises:
        InputError: a render cannot be read, or the records cannot be written.
    """
    records: list[Record] = []
    for step in steps if scene.test else ():
        folder, label = job.folder / f"test/ours_{step}", Label(job.folder.name, scene.name, f"{method}/{step}", "raw")
        files = pair_folders(folder / "renders", folder / "gt", label)
        records += measure_files(files, background=scene.background)
    cost: dict[str, float | None] = {
        "milliseconds": None if seconds is None else 1e3 * seconds,
        "gaussians": float(count),
    }
    reasons = {} if seconds is not None else {"milliseconds": "interrupted: only the last part was timed"}
    records.append(Record("cost", job.folder.name, scene.name, method, "", "raw", cost, reasons))
    write_records(job.folder / "records.jsonl", records)


def held_out_psnr(folder: Path) -> tuple[float | None, float | None]:
    """Mean PSNR in dB of the held-out renders after the first and after the last step, from a run's records.

    Args:
        folder: folder of the run.

    Returns:
        The two means; None, None if no view is held out.
    """
    quality = [record for record in read_records(folder / "records.jsonl") if record.kind == "quality"]
    if not quality:
        return None, None
    first, last = (
        [record.metrics["psnr"] for record in quality if record.splat == quality[index].splat] for index in (0, -1)
    )
    return _mean(first), _mean(last)


def _mean(values: Sequence[float | None]) -> float:
    return statistics.fmean(value for value in values if value is not None)
