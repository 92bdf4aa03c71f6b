"""What training jobs share: a Lightning trainer from the configuration, in a run's folder."""

import copy
import logging
import signal
import threading
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import torch
from omegaconf import DictConfig, OmegaConf, open_dict

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.runs.instantiate import build
from gaussian_enhancer.runs.run import Run, effective_config
from gaussian_enhancer.train.processes import launched_externally

SPAWNED = ("auto", "ddp", "ddp_spawn")
"""Strategies for which a job starts its processes itself; all others are left to Lightning."""


def make_trainer(cfg: DictConfig, job: Run, checkpoint: str, part: str = "", **overrides: Any) -> Any:
    """A trainer that logs and keeps its checkpoint in a run's folder.

    Callbacks are those of the group ``callbacks`` and, after them, the user's own in ``trainer.callbacks``.

    Args:
        cfg: the job's configuration with ``trainer``, ``callbacks``, ``logger``, ``profiler`` and ``runtime``.
        job: the run.
        checkpoint: name of the file, without ending, that a killed training goes on from.
        part: of the run, where it has several trainings; each logs in a folder of its own.
        **overrides: options of the trainer that win over the configuration's.

    Raises:
        InputError: the logger needs a package that is not installed.
    """
    from lightning.pytorch.strategies import DDPStrategy

    from gaussian_enhancer.train.loggers import RunSetup, make_loggers

    values = effective_config(result_configuration(cfg))
    cfg = _with_run_description(cfg, job, part)
    loggers = make_loggers(cfg.logger)
    options: dict[str, Any] = {"use_distributed_sampler": False}  # samples are split by the data module
    if spawns_processes(cfg) and device_count(cfg) > 1:
        # Nothing is sent between two steps but gradients: processes may have unequal numbers of views.
        options["strategy"] = DDPStrategy(find_unused_parameters=True, broadcast_buffers=False)
    if cfg.get("profiler") is not None:
        options["profiler"] = build(cfg.profiler, dirpath=str(job.folder))
    return build(
        cfg.trainer,
        callbacks=[RunSetup(cfg.runtime, values), *_callbacks(cfg, job, checkpoint), *_image_logger(loggers)],
        logger=loggers,
        enable_progress_bar=cfg.runtime.progress,
        default_root_dir=str(job.folder),
        **options,
        **overrides,
    )


def _with_run_description(cfg: DictConfig, job: Run, part: str) -> DictConfig:
    """The configuration with ``this_run``, to which loggers refer, filled in."""
    dash = f"-{part}" if part else ""
    configuration = copy.deepcopy(cfg)
    with open_dict(configuration):
        configuration.this_run = {
            "folder": str(job.folder / part),
            "id": f"{job.digest}{dash}",
            "name": f"{job.folder.name}{dash}",
            "job": job.folder.parent.name,
        }
    return configuration


def _callbacks(cfg: DictConfig, job: Run, checkpoint: str) -> list[Any]:
    """The callbacks of the group, and after them the user's own."""
    from hydra.utils import get_object
    from lightning.pytorch.callbacks import ModelCheckpoint, ProgressBar

    group = [node for node in cfg.get("callbacks", {}).values() if node is not None]
    built = []
    for node in (*group, *(cfg.trainer.get("callbacks") or ())):
        made = get_object(node._target_)
        kept = isinstance(made, type) and issubclass(made, ModelCheckpoint) and node.get("dirpath") is None
        built.append(build(node, **({"dirpath": str(job.folder), "filename": checkpoint} if kept else {})))
    return [one for one in built if cfg.runtime.progress or not isinstance(one, ProgressBar)]


def _image_logger(loggers: list[Any]) -> list[Any]:
    """The callback that logs tables and images, where a logger takes them."""
    from gaussian_enhancer.train.validation_images import ABLE, ValidationImages

    return [ValidationImages(loggers)] if any(isinstance(logger, ABLE) for logger in loggers) else []


def result_configuration(cfg: DictConfig) -> DictConfig:
    """The part of the configuration that determines the result: no logger, profiler, devices or limit on bad samples.

    Runs that differ in these alone have one folder, so that a training may go on under another logger, or shared.

    Args:
        cfg: the job's whole configuration.
    """
    same = copy.deepcopy(cfg)
    with open_dict(same):
        for name in ("logger", "this_run", "profiler", "study", "bad_share"):
            same.pop(name, None)
        for name in ("devices", "strategy"):
            same.trainer.pop(name, None)
    return same


def spawns_processes(cfg: DictConfig) -> bool:
    """Whether the job starts the processes of a shared training, and not Lightning's strategy or a cluster."""
    return cfg.trainer.get("strategy", "auto") in SPAWNED


def spawn_count(cfg: DictConfig) -> int:
    """How many processes the job has to start.

    Args:
        cfg: the job's whole configuration.

    Raises:
        InputError: the number of devices cannot be used.
    """
    return 1 if not spawns_processes(cfg) or launched_externally() else device_count(cfg)


def device_count(cfg: DictConfig) -> int:
    """How many devices train together: ``trainer.devices`` as Lightning takes it, a number, a list, or auto.

    Raises:
        InputError: it is none of these, or a number below 1.
    """
    devices, accelerator = cfg.trainer.get("devices", "auto"), cfg.trainer.get("accelerator", "auto")
    if OmegaConf.is_list(devices) and len(devices):
        return len(devices)
    if devices in ("auto", -1, "-1"):
        cards = torch.cuda.device_count() if accelerator in ("auto", "gpu", "cuda") else 0
        return max(1, cards)
    if isinstance(devices, bool) or not isinstance(devices, int) or devices < 1:
        raise InputError("trainer.devices", f"is {devices!r}", "give auto, or the number of processes, 1 or more")
    return devices


@contextmanager
def stopped_by_ctrl_c(trainer: Any) -> Iterator[None]:
    """Raise KeyboardInterrupt where Ctrl-C stops a trainer.

    Lightning ends the process with exit code 1 instead, and leaves Ctrl-C without effect from then on.

    Args:
        trainer: works inside the context.
    """
    in_main = threading.current_thread() is threading.main_thread()  # no other can be interrupted
    before = signal.getsignal(signal.SIGINT)
    try:
        yield
    except SystemExit:
        if not trainer.interrupted:
            raise
        raise KeyboardInterrupt from None
    finally:
        if in_main:
            signal.signal(signal.SIGINT, before)


def quieten() -> None:
    """Silence Lightning's routine messages."""
    logging.getLogger("lightning.pytorch").setLevel(logging.WARNING)
    logging.getLogger("lightning.fabric").setLevel(logging.WARNING)
    known = "exists and is not empty|many workers|is deprecated|in eval mode|recommended to use|find_unused_parameters"
    warnings.filterwarnings("ignore", message=f".*({known}).*")
