"""Composing the configuration of one job within another."""

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
        name: the other job.
        cfg: the calling job's configuration, from which ``runs`` and ``runtime`` are taken.
        overrides: as on the command line.
        **values: top-level values that a command line cannot hold.

    Raises:
        InputError: the overrides are refused.
    """
    words = tuple(overrides)
    try:
        job = copy.deepcopy(_compose_cached(name, words))
    except (HydraException, OmegaConfBaseException) as error:
        raise InputError(f"{name} {' '.join(words)}", f"is refused ({_first_line(error)})", "mend it") from error
    with open_dict(job):
        job.update({"runs": cfg.runs, "runtime": cfg.runtime, **values})
    return job


@functools.lru_cache(maxsize=512)
def _compose_cached(name: str, overrides: tuple[str, ...]) -> DictConfig:
    """Cached, since composing takes a tenth of a second and studies ask for the same configuration many times."""
    return compose(name, overrides=list(overrides))


def _first_line(error: Exception) -> str:
    return str(error).strip().splitlines()[0]
