"""A new network is its file: it is found, saved and loaded again; what could not be is refused before a training."""

import sys

import pytest
import torch

import gaussian_enhancer.network
from gaussian_enhancer.align.references import ReferenceConfig
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.infer import weights
from gaussian_enhancer.network.baselines.identity import Identity
from gaussian_enhancer.network.catalogue import NetworkCatalogue
from gaussian_enhancer.network.network import Network

SOURCE = """
from collections.abc import Sequence

import torch
from torch import nn

from gaussian_enhancer.network.network import Network


class Helper(nn.Module):
    pass


class Brightened(Network):
    def __init__(self, widths: Sequence[int] = (4,), slope: float = 0.1, activation: str = "relu", bias: bool = True):
        super().__init__()
        self.describe(locals())
        self.gain = nn.Parameter(torch.full((3, widths[0]), slope))

    def stages(self, views):
        return (views.render + self.gain.mean(),)
"""


@pytest.fixture
def added(tmp_path, monkeypatch):
    """A network whose file was put into the package, and nothing else."""
    (tmp_path / "brightened.py").write_text(SOURCE)
    monkeypatch.setattr(gaussian_enhancer.network, "__path__", [*gaussian_enhancer.network.__path__, str(tmp_path)])
    catalogue = NetworkCatalogue()
    monkeypatch.setattr(weights, "NETWORKS", catalogue)
    yield catalogue
    sys.modules.pop("gaussian_enhancer.network.brightened", None)


def test_a_network_of_a_new_file_is_found_saved_and_loaded(added, tmp_path):
    network = added["Brightened"](widths=[5], slope=0.25, activation="gelu", bias=False)
    weights.require_saveable(network)
    weights.save_weights(tmp_path / "a.safetensors", network, ReferenceConfig(), {})
    loaded = weights.load_weights(tmp_path / "a.safetensors").network
    assert loaded.design == {
        "network": "Brightened",
        "widths": [5],
        "slope": 0.25,
        "activation": "gelu",
        "bias": False,
    }
    assert torch.equal(loaded.gain, network.gain)
    assert "Brightened" in set(added)
    assert "Helper" not in added


def test_nothing_but_networks_of_the_package_is_found():
    catalogue = NetworkCatalogue()
    assert {
        "SIF",
        "SSIFLR",
        "SSIFSR",
        "PaperSIF",
        "PaperSSIFLR",
        "PaperSSIFSR",
        "Cascade",
        "NAFNet",
        "EDVR",
        "Identity",
        "Bicubic",
    } == set(catalogue)
    assert "Network" not in catalogue  # abstract
    assert "Block" not in catalogue  # a part of networks
    assert "os.system" not in catalogue


class Elsewhere(Identity):
    """A network outside the package."""


class Forgetful(Network):
    """Depends on a value that it does not describe."""

    def __init__(self, width: int = 4) -> None:
        super().__init__()
        self.describe({})
        self.gain = torch.nn.Parameter(torch.ones(width))

    def stages(self, views):
        return (views.render,)


def test_what_could_not_be_loaded_is_refused_before_a_training(monkeypatch):
    with pytest.raises(InputError, match=r"could not describe.*Elsewhere.*put its file into"):
        weights.require_saveable(Elsewhere())
    monkeypatch.setattr(weights, "NETWORKS", {"Forgetful": Forgetful})
    weights.require_saveable(Forgetful())
    with pytest.raises(InputError, match=r"built otherwise.*gain"):
        weights.require_saveable(Forgetful(width=8))


@pytest.mark.parametrize(
    "change", [{"slope": float("inf")}, {"slope": "1"}, {"activation": "x" * 65}, {"widths": []}, {"shell": 1}]
)
def test_values_of_other_types_are_refused(added, change):
    design = {**added["Brightened"]().design, **change}
    with pytest.raises(ValueError, match=next(iter(change))):
        weights.build_design(design)
