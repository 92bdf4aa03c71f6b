"""The jobs of the campaign at the smallest scale: their inputs, their commands, and what their results are."""

import hashlib
import json
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from omegaconf import OmegaConf
from PIL import Image
from safetensors.torch import load_file

from gaussian_enhancer.metrics.records import Record, read_records
from gaussian_enhancer.splat.io.open import read_splat
from gaussian_enhancer.splat.io.ply import write_ply
from support.captures_on_disk import write_transforms
from support.job_config import QUIET
from support.synthetic_runs import coloured_sheet, write_plane_run

SMALL = (
    "settings.max_gaussians=60",
    "++settings.start_gaussians=60",
    "settings.init=random",
    "settings.snapshots=[0.5]",
)
TRAINING = (
    "trainer=smoke",
    "logger=csv",
    "fusion=sif",
    "fusion.widths=[8,8,8]",
    "fusion.blocks=[1,1,1]",
    "trainer.max_steps=6",
    "save_every=2",
    "data.augmentation.crop=16",
    "data.loading.batch_size=2",
    "data.steps_per_epoch=2",
    "data.train=[first]",
    "data.validation=[second]",
)
TABLE = (
    "table=9",
    f"hydra.searchpath=[file://{Path(__file__).parent / 'suite'}]",
    "scale=kill",
    "results=results",
    "workers=1",
)


@dataclass(frozen=True)
class Job:
    """One job.

    Args:
        words: its command.
        make: writes its inputs into a folder.
        other: more words, that ask for something else in the same output folder; none where there is no such option.
    """

    words: tuple[str, ...]
    make: Callable[[Path], Any]
    other: tuple[str, ...] = ()


def make_planes(folder: Path) -> None:
    write_plane_run(folder / "first", views=4, size=(24, 32))
    write_plane_run(folder / "second", views=4, size=(24, 32), seed=1)


def make_captures(folder: Path) -> None:
    for name in ("capture", "learnt", "judged"):
        write_transforms(folder / name)


def make_filmed(folder: Path) -> None:
    """The first run, with a splat: a sheet of coloured Gaussians."""
    make_planes(folder)
    write_ply(folder / "first/splat.ply", coloured_sheet(12))


JOBS: dict[str, Job] = {
    "fit": Job(
        (
            "fit",
            "scene=transforms",
            "scene.path=capture",
            "settings.steps=8",
            "settings.snapshots=[0.5]",
            *SMALL,
            *QUIET,
        ),
        lambda folder: write_transforms(folder / "capture"),
        ("settings.seed=1",),
    ),
    "train": Job(("train", *TRAINING, *QUIET), make_planes, ("seed=1",)),
    "enhance": Job(("enhance", "run=first", *QUIET), make_planes, ("strength=0.5",)),
    "tables": Job(("tables", *TABLE, *QUIET), make_captures),
    "video": Job(("video", "run=first", "frames=6", *QUIET), make_filmed),
    "distil": Job(
        ("distil", "run=first", "settings.steps=8", "settings.views=2", "prune=true", *QUIET),
        make_filmed,
        ("settings.seed=1",),
    ),
}


# What is compared ------------------------------------------------------------------------------------------------

PASSING = ("done", "running", "failed", "hparams.yaml", "last.ckpt")
"""Files that hold times or processes, or that a finished job no longer reads."""
CACHES = {"locks", "samples", "photos"}
"""Folders of what can be made again, named by when their source was finished."""
TIMES = ("minutes", "time")
MADE = re.compile(r"measured: \d{4}-|sha256 of the records: ")
"""Lines of a table that tell times."""
COMMIT = re.compile(r"\b[0-9a-f]{10}\+?")
"""A commit; the campaign's own record, which it writes as it goes, makes its working tree a changed one."""


def visible(folder: Path) -> list[Path]:
    """All files but hidden ones, which are those that were being written when a process was killed."""
    return sorted(path for path in folder.rglob("*") if path.is_file() and not path.name.startswith("."))


def result(folder: Path) -> dict[str, Any]:
    """What a job's output says, by file, without times."""
    names = [path.relative_to(folder) for path in visible(folder) if path.name not in PASSING]
    return {str(name): content(folder / name) for name in names if CACHES.isdisjoint(name.parts)}


def reasons(record: Record) -> dict[str, str]:
    """Why values are missing, but for the duration, which an interrupted run lacks."""
    return {name: reason for name, reason in record.reasons.items() if name != "milliseconds"}


def content(path: Path) -> Any:
    """What a file says, without the times that it tells."""
    if path.suffix == ".jsonl":
        return [
            (r.kind, r.scene, r.splat, r.view, r.variant, r.seed, reasons(r), r.sources, r.kind == "cost" or r.metrics)
            for r in read_records(path)
        ]
    if path.suffix == ".safetensors":
        return {name: digest(value.numpy().tobytes()) for name, value in load_file(path).items()}
    if path.name == "card.json":
        return {key: value for key, value in json.loads(path.read_text()).items() if key not in TIMES}
    if path.suffix in (".md", ".tex"):  # a table tells when its records were made, and their digest, which holds times
        told = [line for line in path.read_text(encoding="utf-8").splitlines() if not MADE.search(line)]
        return digest(COMMIT.sub("", "\n".join(told)).encode())
    return digest(path.read_bytes())


def digest(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()


def differences(whole: dict[str, Any], found: dict[str, Any]) -> list[str]:
    """The files in which two results differ."""
    return sorted(name for name in whole.keys() | found.keys() if whole.get(name) != found.get(name))


# What is whole ---------------------------------------------------------------------------------------------------


def cut(folder: Path) -> list[str]:
    """Files that can be seen and cannot be read."""
    found = []
    for path in visible(folder):
        try:
            _read(path)
        except Exception as error:
            found.append(f"{path.relative_to(folder)}: {error}"[:200])
    return found


def _read(path: Path) -> None:
    if path.name in ("lock", "metrics.csv") or path.parent.name == "locks":
        return
    if path.suffix in (".png", ".jpg"):
        Image.open(path).load()
    elif path.suffix == ".npy":
        np.load(path)
    elif path.suffix == ".jsonl":
        read_records(path)
    elif path.suffix == ".json" or path.name in ("done", "running", "failed"):
        json.loads(path.read_text())
    elif path.suffix == ".yaml":
        OmegaConf.load(path)
    elif path.suffix == ".safetensors":
        load_file(path)
    elif path.suffix == ".ply":
        read_splat(path)
    elif path.suffix in (".pt", ".ckpt"):
        torch.load(path, weights_only=True)
    elif not path.read_bytes():
        raise ValueError("is empty")


def early(folder: Path, whole: dict[str, Any]) -> list[str]:
    """Files of runs that are marked as done and that are not what they should be."""
    runs = [mark.parent for mark in folder.rglob("done")]
    found = result(folder)
    wrong = []
    for run in runs:
        inside = f"{run.relative_to(folder)}/"
        both = {name for name in whole.keys() | found.keys() if name.startswith(inside)}
        wrong += sorted(name for name in both if whole.get(name) != found.get(name))
    return wrong
