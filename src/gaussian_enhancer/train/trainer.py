"""Construction of the Lightning trainer of a run from the configuration, shared by all training jobs."""

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
from gaussian_enhancer.runs.run import Run, result_values
from gaussian_enhancer.train.processes import launched_externally

SPAWN_STRATEGIES = ("auto", "ddp", "ddp_spawn")
"""Strategies for which a job starts its processes itself; all others are left to Lightning."""


def make_trainer(cfg: DictConfig, job: Run, checkpoint: str, name: str = "", **overrides: Any) -> Any:
    """Make a trainer that logs and writes checkpoints in a run's folder.

    Its callbacks are those of the group ``callbacks``, followed by the user's own in ``trainer.callbacks``.

    Args:
        cfg: the job's configuration with ``trainer``, ``callbacks``, ``logger``, ``profiler`` and ``runtime``.
        job: the run.
        checkpoint: file name, without ending, of the checkpoint that an interrupted training resumes from.
        name: name of this training if the run has several; each logs in its own folder.
        **overrides: options of the trainer that take precedence over the configuration.

    Raises:
        InputError: a logger needs a package that is not installed, or gradients are to be accumulated.
    """
    if cfg.trainer.get("accumulate_grad_batches", 1) != 1:  # samples and checkpoints are counted by steps
        raise InputError("trainer.accumulate_grad_batches", "is not supported", "raise data.loading.batch_size")
    from lightning.pytorch.strategies import DDPStrategy

    from gaussian_enhancer.train.loggers import RunSetup, make_loggers

    values = result_values(result_configuration(cfg))
    cfg = _with_run_description(cfg, job, name)
    loggers = make_loggers(cfg.logger)
    options: dict[str, Any] = {"use_distributed_sampler": False}  # samples are split by the data module
    if spawns_processes(cfg) and device_count(cfg) > 1:
        # Only gradients are exchanged, no buffers: processes may have unequal numbers of validation views.
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


def _with_run_description(cfg: DictConfig, job: Run, name: str) -> DictConfig:
    """The configuration with the section ``this_run``, which loggers refer to."""
    suffix = f"-{name}" if name else ""
    configuration = copy.deepcopy(cfg)
    with open_dict(configuration):
        configuration.this_run = {
            "folder": str(job.folder / name),
            "id": f"{job.digest}{suffix}",
            "name": f"{job.folder.name}{suffix}",
            "job": job.folder.parent.name,
        }
    return configuration


def _callbacks(cfg: DictConfig, job: Run, checkpoint: str) -> list[Any]:
    """Build the callbacks of the group ``callbacks``, followed by the user's own."""
    from hydra.utils import get_object
    from lightning.pytorch.callbacks import ModelCheckpoint, ProgressBar

    group = [node for node in cfg.get("callbacks", {}).values() if node is not None]
    built = []
    for node in (*group, *(cfg.trainer.get("callbacks") or ())):
        callback_type = get_object(node._target_)
        is_default_checkpoint = (
            isinstance(callback_type, type)
            and issubclass(callback_type, ModelCheckpoint)
            and node.get("dirpath") is None
        )
        options = {"dirpath": str(job.folder), "filename": checkpoint} if is_default_checkpoint else {}
        built.append(build(node, **options))
    return [callback for callback in built if cfg.runtime.progress or not isinstance(callback, ProgressBar)]


def _image_logger(loggers: list[Any]) -> list[Any]:
    """The callback that logs tables and images, if a logger accepts them."""
    from gaussian_enhancer.train.validation_images import IMAGE_LOGGERS, ValidationImages

    return [ValidationImages(loggers)] if any(isinstance(logger, IMAGE_LOGGERS) for logger in loggers) else []


def result_configuration(cfg: DictConfig) -> DictConfig:
    """The part of the configuration that determines the result: no logger, profiler, devices or limit on bad samples.

    Runs that differ only in the other parts share a folder, so that a training can be resumed with another logger, or
    on another number of devices.

    Args:
        cfg: the job's whole configuration.
    """
    configuration = copy.deepcopy(cfg)
    with open_dict(configuration):
        for name in ("logger", "this_run", "profiler", "study", "bad_share"):
            configuration.pop(name, None)
        for name in ("devices", "strategy"):
            configuration.trainer.pop(name, None)
    return configuration


def spawns_processes(cfg: DictConfig) -> bool:
    """Whether the job itself starts the processes of a multi-process training, and not Lightning's strategy."""
    return cfg.trainer.get("strategy", "auto") in SPAWN_STRATEGIES


def spawn_count(cfg: DictConfig) -> int:
    """Number of processes that the job has to start.

    Args:
        cfg: the job's whole configuration.

    Raises:
        InputError: ``trainer.devices`` is not valid.
    """
    return 1 if not spawns_processes(cfg) or launched_externally() else device_count(cfg)


def device_count(cfg: DictConfig) -> int:
    """Number of devices that train together, from ``trainer.devices``: a number, a list, or auto, as in Lightning.

    Raises:
        InputError: ``trainer.devices`` is none of these, or a number below 1.
    """
    devices, accelerator = cfg.trainer.get("devices", "auto"), cfg.trainer.get("accelerator", "auto")
    if OmegaConf.is_list(devices) and len(devices):
        return len(devices)
    if devices in ("auto", -1, "-1"):
        gpus = torch.cuda.device_count() if accelerator in ("auto", "gpu", "cuda") else 0
        return max(1, gpus)
    if isinstance(devices, bool) or not isinstance(devices, int) or devices < 1:
        raise InputError("trainer.devices", f"is {devices!r}", "give auto, or the number of processes, 1 or more")
    return devices


@contextmanager
def raise_interrupt(trainer: Any) -> Iterator[None]:
    """Context in which Ctrl-C raises KeyboardInterrupt while a trainer works.

    Lightning would end the process with exit code 1 instead, and leave Ctrl-C without effect afterwards.

    Args:
        trainer: the trainer that works inside the context.
    """
    in_main_thread = threading.current_thread() is threading.main_thread()  # only the main thread handles signals
    handler = signal.getsignal(signal.SIGINT)
    try:
        yield
    except SystemExit:
        if not trainer.interrupted:
            raise
        raise KeyboardInterrupt from None
    finally:
        if in_main_thread:
            signal.signal(signal.SIGINT, handler)


def silence_lightning() -> None:
    """Silence Lightning's routine messages."""
    logging.getLogger("lightning.pytorch").setLevel(logging.WARNING)
    logging.getLogger("lightning.fabric").setLevel(logging.WARNING)
    patterns = (
        "exists and is not empty|many workers|is deprecated|in eval mode|recommended to use|find_unused_parameters"
    )
    warnings.filterwarnings("ignore", message=f".*({patterns}).*")
