"""The suite's jobs at a scale of seconds: tiny worlds, fitted and trained in earnest."""

from pathlib import Path

from omegaconf import DictConfig

from ablations.jobs import tables
from ablations.suite.descriptions import read_experiment, requested_names
from ablations.suite.plan import PlannedRun, plan_runs
from gaussian_enhancer.metrics.records import read_records
from support.job_config import QUIET, initialised, job_config, run_job

SUITE = f"hydra.searchpath=[file://{Path(__file__).parent / 'suite'}]"
TINY = (SUITE, "scale=tiny", "results=results", *QUIET, "workers=1")


def configured(*overrides: str) -> DictConfig:
    """Configuration of the job ``tables``, which makes one run at a time unless told otherwise."""
    return job_config("tables", *TINY, *overrides)


def started(*overrides: str) -> None:
    """Run the job in the current folder."""
    run_job(tables.run, configured(*overrides))


def plan(*overrides: str) -> list[PlannedRun]:
    """Every run that the job needs."""
    cfg = configured(*overrides)
    with initialised():
        return plan_runs(cfg, [read_experiment(name, cfg.scale) for name in requested_names(cfg.table)])


def content(folder: Path, name: str = "table_10") -> list[tuple[object, ...]]:
    """What the records of a table say, but for when they were measured."""
    found = read_records(folder / f"results/tiny/{name}.jsonl")
    return [(r.scene, r.splat, r.view, r.variant, r.seed, r.metrics, r.sources, r.reasons) for r in found]
