"""Composition of one job's configuration inside another job."""

import copy
import functools
from collections.abc import Iterable

from hydra import compose
from hydra.errors import HydraException
from omegaconf import DictConfig, open_dict
from omegaconf.errors import OmegaConfBaseException

from gaussian_enhancer.errors import InputError


def compose_job(name: str, cfg: DictConfig, overrides: Iterable[str] = (), **values: object) -> DictConfig:
    """Compose another job's configuration. Mandatory values may still be missing in it.

    Args:
        name: name of the other job.
        cfg: the calling job's configuration; ``runs`` and ``runtime`` are copied from it.
        overrides: overrides as on the command line.
        **values: top-level values that cannot be written as overrides.

    Raises:
        InputError: Hydra refuses the overrides.
    """
    frozen_overrides = tuple(overrides)
    try:
        job = copy.deepcopy(_compose_cached(name, frozen_overrides))
    except (HydraException, OmegaConfBaseException) as error:
        cause = str(error).strip().splitlines()[0]
        subject = f"{name} {' '.join(frozen_overrides)}"
        raise InputError(subject, f"is refused ({cause})", "correct the override") from error
    with open_dict(job):
        job.update({"runs": cfg.runs, "runtime": cfg.runtime, **values})
    return job


@functools.lru_cache(maxsize=512)
def _compose_cached(name: str, overrides: tuple[str, ...]) -> DictConfig:
    """Composed configuration, cached: composing takes 0.1 s, and studies request the same configuration many times."""
    return compose(name, overrides=list(overrides))
