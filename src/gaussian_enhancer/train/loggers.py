"""What a training is watched with: rows in a file always, and wandb or TensorBoard beside them.

Whichever logger is live, a run keeps its scalars as ``metrics.csv``, which reports are made from.
"""

import csv as tables
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from lightning.pytorch.loggers import CSVLogger, Logger, TensorBoardLogger, WandbLogger
from lightning.pytorch.loggers.csv_logs import ExperimentWriter
from lightning.pytorch.loggers.logger import rank_zero_experiment

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.files import whole_file


@dataclass(frozen=True)
class Watched:
    """What loggers are told of a run.

    Args:
        folder: where logs are kept.
        id: of the run's content, so that a training that goes on is the same run to the logger.
        name: to show.
        group: the study or sweep that the run belongs to.
        job: what is done.
        config: resolved values.
    """

    folder: Path
    id: str
    name: str
    group: str
    job: str
    config: Mapping[str, Any] = field(default_factory=dict)


def csv(run: Watched) -> list[Logger]:
    """Scalars as rows of ``log/metrics.csv``."""
    return [LastingCSV(run.folder, name=None, version="log")]


def tensorboard(run: Watched) -> list[Logger]:
    """The same scalars, and images, as TensorBoard's events.

    Raises:
        InputError: TensorBoard is not installed.
    """
    try:
        live = TensorBoardLogger(run.folder, name=None, version="tensorboard", default_hp_metric=False)
    except ModuleNotFoundError as error:
        remedy = "install gaussian-enhancer[tensorboard], or choose logger=csv"
        raise InputError("logger=tensorboard", f"needs a package that is not installed ({error})", remedy) from error
    return [*csv(run), live]


def wandb(run: Watched, project: str = "gaussian-enhancer", offline: bool = True) -> list[Logger]:
    """The same scalars, tables and images, as a run of wandb, in the run's folder.

    Offline nothing leaves the machine: ``wandb sync --append FOLDER/wandb/offline-*`` sends it later, the parts of a
    training that was killed into one run, since they share its id. Online an interrupted run is continued.

    Args:
        run: what is logged.
        project: wandb's.
        offline: keep everything on this machine.
    """
    import wandb as client

    told: dict[str, Any] = {"group": run.group, "job_type": run.job, "config": dict(run.config)}
    # The mode as an argument: Lightning's own `offline` would turn every later run of the process offline as well.
    told |= {"mode": "offline", "resume": None} if offline else {"mode": "online"}
    # On a busy machine its service needs longer to start than the half minute that wandb grants it.
    settings = client.Settings(silent=offline, console="off", x_service_wait=300, init_timeout=300)
    live = WandbLogger(run.name, run.folder, id=run.id, project=project, settings=settings, **told)
    return [*csv(run), live]


class LastingCSV(CSVLogger):
    """Lightning's CSV logger, which would delete the rows of a training that goes on, and keeps them here.

    Rows from the first step that is logged again onwards were written between the last checkpoint and the kill: they
    are dropped.
    """

    @property
    @rank_zero_experiment
    def experiment(self) -> Any:
        """The writer; it starts with the rows that are there."""
        if self._experiment is None:
            self._experiment = _LastingWriter(self.log_dir)
        return self._experiment


class _LastingWriter(ExperimentWriter):
    def __init__(self, log_dir: str) -> None:
        self.resumed = False
        super().__init__(log_dir)
        if self.resumed:
            self.metrics_keys = self._kept()[0]

    def _check_log_dir_exists(self) -> None:
        self.resumed = Path(self.metrics_file_path).is_file()

    def log_metrics(self, metrics_dict: dict[str, float], step: int | None = None) -> None:
        """Record metrics."""
        if self.resumed and step is not None:
            names, rows = self._kept()
            with whole_file(self.metrics_file_path) as path, path.open("w", newline="") as file:
                writer = tables.DictWriter(file, names)
                writer.writeheader()
                writer.writerows(row for row in rows if int(row["step"]) < step)
            self.resumed = False
        super().log_metrics(metrics_dict, step)

    def _kept(self) -> tuple[list[str], list[dict[str, str]]]:
        with open(self.metrics_file_path, newline="") as file:
            reader = tables.DictReader(file)
            return list(reader.fieldnames or ()), list(reader)


@contextmanager
def watching(loggers: Sequence[Logger]) -> Iterator[None]:
    """End wandb's run with the training, so that the next one of a sweep in the same process is a run of its own."""
    failed = True
    try:
        yield
        failed = False
    finally:
        for logger in loggers:
            if isinstance(logger, WandbLogger):
                import wandb as client

                if client.run is not None and client.run.id == logger.version:
                    client.finish(exit_code=int(failed))
