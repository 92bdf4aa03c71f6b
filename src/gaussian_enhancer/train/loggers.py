"""Construction of the loggers of a training, and a CSV logger that keeps its rows when a training is resumed.

Every choice of ``conf/logger`` has the CSV logger: reports are made from its ``metrics.csv``.
"""

import csv
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from hydra.errors import InstantiationException
from lightning import Callback, LightningModule, Trainer
from lightning.pytorch.loggers import CSVLogger, Logger, WandbLogger
from lightning.pytorch.loggers.csv_logs import ExperimentWriter
from lightning.pytorch.loggers.logger import rank_zero_experiment
from omegaconf import DictConfig

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.files import atomic_write
from gaussian_enhancer.runs.instantiate import build
from gaussian_enhancer.runs.runtime import start


def make_loggers(node: DictConfig) -> list[Logger]:
    """Build the loggers of a configuration.

    Args:
        node: the configuration of one Lightning logger, with ``_target_``, or of several by name.

    Raises:
        InputError: a logger needs a package that is not installed.
    """
    nodes = (
        {"logger": node} if "_target_" in node else {f"logger.{name!s}": entry for name, entry in node.items() if entry}
    )
    return [_make(name, entry) for name, entry in nodes.items()]


def _make(name: str, node: DictConfig) -> Logger:
    try:
        logger: Logger = build(node)
    except InstantiationException as error:
        if not isinstance(error.__cause__, ModuleNotFoundError):
            raise
        received = f"needs a package that is not installed ({error.__cause__})"
        remedy = "install it, for instance as gaussian-enhancer[tensorboard], or choose logger=csv"
        raise InputError(name, received, remedy) from error
    return logger


class RunSetup(Callback):
    """Sets up every process of a training, and passes the run's configuration to loggers.

    Args:
        runtime: the section ``runtime`` of the job's configuration.
        values: the part of the configuration that determines the result; it is logged.
    """

    def __init__(self, runtime: DictConfig, values: Mapping[str, Any]) -> None:
        self.runtime, self.values = runtime, dict(values)

    def setup(self, trainer: Trainer, pl_module: LightningModule, stage: str) -> None:
        """Set up the process as the job's configuration demands, and log the configuration before fitting."""
        start(self.runtime)
        if stage == "fit":
            for logger in trainer.loggers:
                logger.log_hyperparams(self.values)


class ResumableCSVLogger(CSVLogger):
    """Lightning's CSV logger, but with the earlier rows kept when a training is resumed; Lightning's own deletes them.

    Rows from the first newly logged step onwards are dropped: they were written after the checkpoint that the training
    resumes from.
    """

    @property
    @rank_zero_experiment
    def experiment(self) -> Any:
        """The writer of the file; it keeps the rows that the file already has."""
        if self._experiment is None:
            self._experiment = _ResumableWriter(self.log_dir)
        return self._experiment


class _ResumableWriter(ExperimentWriter):
    """Writer that tolerates a truncated file, for instance after a full disk: at most the last row is lost."""

    def __init__(self, log_dir: str) -> None:
        self.resumed = False
        super().__init__(log_dir)
        if self.resumed:
            self.metrics_keys = self._complete_rows()[0]

    def _check_log_dir_exists(self) -> None:
        self.resumed = Path(self.metrics_file_path).is_file()

    def log_metrics(self, metrics_dict: dict[str, float], step: int | None = None) -> None:
        """Record metrics."""
        if self.resumed and step is not None:
            names, rows = self._complete_rows()
            self._write(names, [row for row in rows if int(row["step"]) < step])
            self.resumed = False
        super().log_metrics(metrics_dict, step)

    def save(self) -> None:
        """Append the recorded rows; if the file is new or gets new columns, write the whole file."""
        if not self.metrics:
            return
        exists = Path(self.metrics_file_path).is_file()
        if self._record_new_keys() or not exists:
            self._write(self.metrics_keys, [*(self._complete_rows()[1] if exists else ()), *self.metrics])
        else:
            with open(self.metrics_file_path, "a", newline="") as file:
                csv.DictWriter(file, self.metrics_keys).writerows(self.metrics)
        self.metrics = []

    def _write(self, names: Sequence[str], rows: Iterable[Mapping[str, Any]]) -> None:
        with atomic_write(self.metrics_file_path) as path, path.open("w", newline="") as file:
            writer = csv.DictWriter(file, names)
            writer.writeheader()
            writer.writerows(rows)

    def _complete_rows(self) -> tuple[list[str], list[dict[str, str]]]:
        """Columns and rows of the file, without a truncated last row."""
        with open(self.metrics_file_path, newline="") as file:
            lines = [line for line in file if line.endswith("\n")]
        reader = csv.DictReader(lines)
        return list(reader.fieldnames or ()), list(reader)


@contextmanager
def finish_wandb_run(loggers: Sequence[Logger]) -> Iterator[None]:
    """End wandb's run with the training, so that a sweep's next training in this process starts a new run."""
    failed = True
    try:
        yield
        failed = False
    finally:
        for logger in loggers:
            if isinstance(logger, WandbLogger):
                import wandb

                if wandb.run is not None and wandb.run.id == logger.version:
                    wandb.finish(exit_code=int(failed))
