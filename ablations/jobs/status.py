"""``gaussian-enhancer status``: state of every run, or of those that tables need."""

from collections.abc import Iterator
from pathlib import Path

from omegaconf import DictConfig

from ablations.suite.descriptions import read_experiment, requested_names
from ablations.suite.method_runs import with_backbones
from ablations.suite.plan import plan_runs
from gaussian_enhancer.errors import refuse_unknown
from gaussian_enhancer.runs.instantiate import require
from gaussian_enhancer.runs.status import NAMES, State, state_of


def run(cfg: DictConfig) -> None:
    """Print a line for each run, then how many there are of each state.

    Args:
        cfg: conf/status.yaml, composed.

    Raises:
        InputError: a table or a state is unknown, or a mark cannot be read.
    """
    require(cfg)
    refuse_unknown("states", cfg.states, NAMES)
    states = list(_begun(Path(cfg.runs)) if cfg.table is None else _needed(cfg))
    for job, name, state in states:
        if cfg.states is None or state.name in cfg.states:
            print(f"{state.name:<12} {job:<6} {name}" + (f": {state.detail}" if state.detail else ""))
    counts = {name: sum(state.name == name for *_, state in states) for name in NAMES}
    print(f"{len(states)} runs: " + ", ".join(f"{count} {name}" for name, count in counts.items()))


def _begun(runs: Path) -> Iterator[tuple[str, str, State]]:
    """Every started run: job, name of its folder, state."""
    for file in sorted(runs.glob("*/*/config.yaml")):
        yield file.parent.parent.name, file.parent.name, state_of(file.parent)


def _needed(cfg: DictConfig) -> Iterator[tuple[str, str, State]]:
    """Every run that tables need."""
    cfg = with_backbones(cfg)
    for step in plan_runs(cfg, [read_experiment(name, cfg.scale) for name in requested_names(cfg.table)]):
        yield step.work.job, step.name, step.state
