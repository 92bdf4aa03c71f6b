"""What training jobs share: a Lightning trainer that keeps one resumable checkpoint, without chatter."""

import copy
import logging
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from omegaconf import DictConfig, open_dict

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.runs.instantiate import build
from gaussian_enhancer.runs.run import Run, effective
from gaussian_enhancer.train.processes import Place

LOGGER = {"_target_": "lightning.pytorch.loggers.CSVLogger", "name": None, "version": "log"}
"""What a run's configuration says of its logger, whichever one is live: the rows that every run keeps."""


def make_trainer(
    cfg: DictConfig,
    job: Run,
    checkpoint: str,
    callbacks: Sequence[Any] = (),
    part: str = "",
    place: Place | None = None,
    **overrides: Any,
) -> Any:
    """A trainer that logs and keeps its checkpoint in a run's folder.

    Args:
        cfg: the job's configuration with ``trainer``, ``logger``, ``save_every`` and ``runtime``.
        job: the run.
        checkpoint: name of the one file, without ending, that a killed training goes on from.
        callbacks: further ones.
        part: of the run, where it has several trainings; each logs in a folder of its own.
        place: of this process among those that train together.
        **overrides: options of the trainer that win over the configuration's.

    Raises:
        InputError: the logger needs a package that is not installed.
    """
    from lightning.pytorch.callbacks import ModelCheckpoint

    from gaussian_enhancer.train.loggers import Watched

    # One file, replaced as a whole: a kill leaves the last or the one before it.
    keep = ModelCheckpoint(
        dirpath=job.folder, filename=checkpoint, every_n_train_steps=cfg.save_every, enable_version_counter=False
    )
    dash = f"-{part}" if part else ""
    watched = Watched(
        job.folder / part,
        f"{job.digest}{dash}",
        f"{job.folder.name}{dash}",
        str(cfg.get("study") or cfg.label),
        job.folder.parent.name,
        effective(alike(cfg)),
    )
    loggers = build(cfg.logger, watched)
    return build(
        cfg.trainer,
        callbacks=[keep, *callbacks, *_shown(loggers)],
        logger=loggers,
        enable_progress_bar=cfg.runtime.progress,
        default_root_dir=str(job.folder),
        **(Place() if place is None else place).options(),
        **overrides,
    )


def _shown(loggers: Sequence[Any]) -> list[Any]:
    """The callback that logs tables and images, where a logger takes them."""
    from gaussian_enhancer.train.validation_images import ABLE, ValidationImages

    return [ValidationImages(loggers)] if any(isinstance(logger, ABLE) for logger in loggers) else []


def alike(cfg: DictConfig) -> DictConfig:
    """The configuration as it determines a training: whoever watches or shares it, whatever bad samples it forgives.

    Runs that differ in these alone have one folder, so that a training may go on under another logger, or shared.

    Args:
        cfg: the job's whole configuration.
    """
    same = copy.deepcopy(cfg)
    with open_dict(same):
        same.logger = LOGGER
        same.pop("study", None)
        same.pop("bad_share", None)
        same.trainer.devices = 1
        same.trainer.pop("strategy", None)
    return same


def processes(cfg: DictConfig) -> int:
    """How many processes train together.

    Args:
        cfg: the job's whole configuration.

    Raises:
        InputError: number of devices or strategy cannot be used.
    """
    count, strategy = cfg.trainer.devices, cfg.trainer.get("strategy", "auto")
    if not isinstance(count, int) or count < 1:
        raise InputError("trainer.devices", f"is {count!r}", "give the number of processes, 1 or more")
    if strategy not in ("auto", "ddp"):
        raise InputError("trainer.strategy", f"is {strategy!r}", "choose auto or ddp")
    return count


@contextmanager
def alone(folder: Path) -> Iterator[None]:
    """Wait until no other process works on a run: equal jobs of a sweep do it once, one after another.

    The lock is the system's own, and goes with the process that holds it, however that ends.

    Args:
        folder: the run's.
    """
    from filelock import FileLock

    with FileLock(folder / "lock"):
        yield


def quieten() -> None:
    """Silence what Lightning says of every training and is no news."""
    logging.getLogger("lightning.pytorch").setLevel(logging.WARNING)
    logging.getLogger("lightning.fabric").setLevel(logging.WARNING)
    known = "exists and is not empty|many workers|is deprecated|in eval mode|recommended to use|find_unused_parameters"
    warnings.filterwarnings("ignore", message=f".*({known}).*")
