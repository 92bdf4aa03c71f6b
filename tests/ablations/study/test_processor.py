"""Jobs that compute on the processor alone say so, and refuse a GPU."""

import importlib

import pytest
import torch

from ablations.jobs import ibgs
from gaussian_enhancer.errors import InputError
from support.job_config import job_config

JOBS = {
    "benchmarks": ("degradation", "networks", "similarity", "splat_kernels"),
    "jobs": ("stability",),
    "scripts": ("artefact_sheet", "diversity", "fingerprints", "realism", "sampler"),
}
REFUSED = r"runtime\.device: is cuda, but this job computes on the processor; choose cpu"


@pytest.mark.parametrize(("package", "name"), [(package, name) for package, names in JOBS.items() for name in names])
def test_a_study_on_the_processor_refuses_a_gpu(package, name) -> None:
    module = importlib.import_module(f"ablations.{package}.{name}")
    cfg = job_config(name)
    assert cfg.runtime.device == "cpu"
    with pytest.raises(InputError, match=REFUSED):
        module.study(cfg, torch.device("cuda"))


def test_ibgs_refuses_a_gpu(monkeypatch) -> None:
    cfg = job_config("ibgs", "fit=nowhere")
    assert cfg.runtime.device == "cpu"
    monkeypatch.setattr(ibgs, "start", lambda runtime: torch.device("cuda"))
    with pytest.raises(InputError, match=REFUSED):
        ibgs.run(cfg)
