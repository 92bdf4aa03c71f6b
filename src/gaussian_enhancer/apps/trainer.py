"""What training jobs share: a Lightning trainer that keeps one resumable checkpoint, without chatter."""

import logging
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from omegaconf import DictConfig

from gaussian_enhancer.apps.build import build
from gaussian_enhancer.errors import InputError


def make_trainer(
    cfg: DictConfig,
    folder: Path,
    checkpoint: str,
    callbacks: Sequence[Any] = (),
    logs: Path | None = None,
    **overrides: Any,
) -> Any:
    """A trainer that logs and keeps its checkpoint in a run's folder.

    Args:
        cfg: the job's configuration with ``trainer``, ``logger``, ``save_every`` and ``runtime``.
        folder: the run's.
        checkpoint: name of the one file, without ending, that a killed training goes on from.
        callbacks: further ones.
        logs: folder of the log; the run's own where None.
        **overrides: options of the trainer that win over the configuration's.

    Raises:
        InputError: the logger needs a package that is not installed.
    """
    from lightning.pytorch.callbacks import ModelCheckpoint

    # One file, replaced as a whole: a kill leaves the last or the one before it.
    keep = ModelCheckpoint(
        dirpath=folder, filename=checkpoint, every_n_train_steps=cfg.save_every, enable_version_counter=False
    )
    try:
        logger = build(cfg.logger, save_dir=str(logs or folder))
    except (ModuleNotFoundError, ImportError) as error:
        received = f"needs a package that is not installed ({error})"
        raise InputError("logger", received, "install it, or logger=csv") from error
    return build(
        cfg.trainer,
        callbacks=[keep, *callbacks],
        logger=logger,
        enable_progress_bar=cfg.runtime.progress,
        default_root_dir=str(folder),
        **overrides,
    )


def quieten() -> None:
    """Silence what Lightning says of every training and is no news."""
    logging.getLogger("lightning.pytorch").setLevel(logging.WARNING)
    warnings.filterwarnings("ignore", message=".*(exists and is not empty|many workers|is deprecated|in eval mode).*")
