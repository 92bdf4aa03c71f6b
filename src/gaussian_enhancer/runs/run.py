"""Run folders, named by the hash of the configuration, with a file that marks completion.

A finished run is reused. A killed sweep therefore resumes where it stopped, and results that several tables need are
computed once (DomainBed names its jobs in the same way).
"""

import hashlib
import json
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from omegaconf import DictConfig, OmegaConf

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.files import write_json, write_text
from gaussian_enhancer.input_files import read_configuration
from gaussian_enhancer.runs import lock, status
from gaussian_enhancer.runs.instantiate import require

IGNORED_KEYS = ("runs", "output", "runtime", "profile")
"""Keys that do not change a result and are left out of the hash: output folders, device, threads."""

REMEDY = "give another output, or delete the folder"

SPLAT_JOBS = ("fit", "distil")
SPLAT_FILES = ("splat.ply", "cameras.json")
"""Files that these jobs write into the folder of a run, and that the folder of a user's own splat may hold as well."""


@dataclass(frozen=True)
class Run:
    """The folder of a run.

    Args:
        folder: the existing folder.
        digest: first eight hexadecimal digits of the hash of the job's name and configuration.
    """

    folder: Path
    digest: str

    @property
    def done(self) -> bool:
        """Whether the folder holds the completed result of this run."""
        return finished_digest(self.folder) == self.digest

    def finish(self) -> None:
        """Mark the run as completed and unlock its folder. This is the last step of a job."""
        write_json(self.folder / status.DONE, {"digest": self.digest, "time": time.time()})
        status.remove_marks(self.folder)
        lock.release(self.folder)


def open_run(cfg: DictConfig, job: str, label: str, locked: bool = True, reused: bool = True) -> Run:
    """Create or find the folder of a run and write its configuration. Unless the run is done, mark it as running.

    The folder is locked until the run is finished, or until `status.track_runs` ends.

    Args:
        cfg: the complete configuration of the job.
        job: name of the job and of the parent folder.
        label: readable part of the folder's name, for instance scene and splat.
        locked: lock the folder; False for processes that share a run whose folder the first process has locked.
        reused: keep a finished run; False for a job that writes all results anew: until it ends, the run is not done.

    Raises:
        InputError: a value marked ``???`` was not given, the folder cannot be written, another process writes it, or it
            holds a different run.
    """
    require(cfg)
    values = result_values(cfg)
    digest = digest_of({"job": job, **values})
    folder = Path(cfg.output) if cfg.get("output") else Path(cfg.runs) / job / f"{label}-{digest}"
    acquired = lock.hold(folder) if locked else False
    try:
        finished = _check_folder(folder, digest, job)
    except InputError:
        if acquired:
            lock.release(folder)
        raise
    write_text(folder / "config.yaml", OmegaConf.to_yaml(OmegaConf.create({"job": job, **values}), sort_keys=True))
    if finished is None or not reused:
        (folder / status.DONE).unlink(missing_ok=True)
        status.mark_running(folder)
    return Run(folder, digest)


def _check_folder(folder: Path, digest: str, job: str) -> str | None:
    """The digest of the finished run in a folder, or None.

    A folder with results of a different run, or with a splat that belongs to no run, is refused.
    """
    finished = finished_digest(folder)
    if finished is None and job in SPLAT_JOBS and not (folder / "config.yaml").exists():
        for file in filter(Path.exists, (folder / name for name in SPLAT_FILES)):
            received = f"belongs to no run of this program, and {job} would replace it"
            raise InputError(file, received, "give another output")
    if finished is not None and finished != digest:
        raise InputError(folder, f"holds another finished run ({finished})", REMEDY)
    if finished is None and (folder / "config.yaml").is_file() and not status.holds_no_result(folder):
        stored = digest_of(read_configuration(folder / "config.yaml"))
        if stored != digest:
            received = f"holds an unfinished run of another configuration ({stored})"
            raise InputError(folder, received, f"{REMEDY}, or use that configuration to resume it")
    return finished


def find_run(cfg: DictConfig, job: str) -> Run | None:
    """Find the run of a configuration; None if it was never started.

    Args:
        cfg: the complete configuration of the job.
        job: name of the job.
    """
    digest = run_digest(cfg, job)
    folders = [Path(cfg.output)] if cfg.get("output") else sorted((Path(cfg.runs) / job).glob(f"*-{digest}"))
    return next((Run(folder, digest) for folder in folders if (folder / "config.yaml").is_file()), None)


def run_digest(cfg: DictConfig, job: str) -> str:
    """The digest of a job's run, whether or not it was ever started."""
    return digest_of({"job": job, **result_values(cfg)})


def finished_digest(folder: Path) -> str | None:
    """The digest of the completed run in a folder; None if there is none.

    Raises:
        InputError: the file ``done`` cannot be read.
    """
    marker = folder / status.DONE
    if not marker.is_file():
        return None
    try:
        return str(json.loads(marker.read_text(encoding="utf-8"))["digest"])
    except (OSError, ValueError, KeyError) as error:
        raise InputError(marker, f"does not mark a completed run ({error})", "delete it to run again") from error


def result_values(cfg: DictConfig) -> dict[str, Any]:
    """The resolved configuration without the keys that do not change a result."""
    values = OmegaConf.to_container(cfg, resolve=True)
    if not isinstance(values, dict):
        raise TypeError(f"a job's configuration is a mapping, got {type(values).__name__}")
    return {str(key): value for key, value in values.items() if key not in IGNORED_KEYS}


def digest_of(values: dict[str, Any]) -> str:
    """Eight hexadecimal digits of SHA-256 over the values in canonical JSON."""
    canonical = json.dumps(values, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(canonical.encode()).hexdigest()[:8]
