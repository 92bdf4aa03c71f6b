"""Heavy packages are imported where they are used: what a fresh process loads."""

import subprocess
import sys

import pytest

from gaussian_enhancer.align.references import ReferenceConfig
from gaussian_enhancer.infer.weights import save_weights
from gaussian_enhancer.network.sif import SIF

HEAVY = (
    "gsplat",
    "kornia",
    "lightning",
    "lpips",
    "matplotlib",
    "plyfile",
    "pycolmap",
    "tensorboard",
    "torchmetrics",
    "torchvision",
    "wandb",
)
"""Packages that enhancing a finished run does not need (numba, which compiles the search of depth, loads scipy)."""

IDLE = (
    "gaussian_enhancer.degrade",
    "gaussian_enhancer.network.baselines",
    "gaussian_enhancer.network.ssif_lr",
    "gaussian_enhancer.network.ssif_sr",
    "gaussian_enhancer.loss",
    "gaussian_enhancer.scene.procedural",
    "gaussian_enhancer.splat.fit",
    "gaussian_enhancer.train",
)
"""Parts of our own that SIF at the render's resolution does not need."""


def printed(*words: str) -> list[str]:
    """Standard output of a fresh Python, in lines."""
    return subprocess.run([sys.executable, *words], capture_output=True, text=True, check=True).stdout.splitlines()


def idle(loaded: list[str]) -> list[str]:
    """The modules that enhancing by SIF does not need."""
    return [name for name in loaded if name.split(".")[0] in HEAVY or any(name.startswith(part) for part in IDLE)]


@pytest.mark.slow
def test_enhance_loads_no_package_and_no_network_that_it_does_not_use(plane_run, tmp_path):
    save_weights(tmp_path / "sif.safetensors", SIF((8, 8, 8), (1, 1, 1)), ReferenceConfig(), {})
    options = [f"run={plane_run}", f"weights={tmp_path / 'sif.safetensors'}", f"output={tmp_path / 'out'}"]
    program = (
        "import sys; from gaussian_enhancer.cli.main import main;"
        f"main(['enhance', *{options!r}, 'runtime.progress=false', 'runtime.threads=1', 'runtime.device=cpu']);"
        "print('loaded', *sys.modules)"
    )
    loaded = next(line for line in printed("-c", program) if line.startswith("loaded ")).split()
    assert len(list((tmp_path / "out").iterdir())) == 2
    assert "gaussian_enhancer.network.sif" in loaded
    assert not idle(loaded)


def test_importing_the_job_enhance_loads_nothing_idle():
    loaded = printed("-c", "import sys, gaussian_enhancer.cli.enhance; print(*sys.modules)")[-1].split()
    assert {"gaussian_enhancer.cli.enhance", "torch"} <= set(loaded)
    assert not idle(loaded)
