import json

import pytest
import torch
from safetensors.torch import load_file, save_file

from gaussian_enhancer.align.alignment import Reprojected, Unwarped
from gaussian_enhancer.align.references import ReferenceConfig
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.infer.weights import build_design, design_of, load_weights, save_weights
from gaussian_enhancer.network.deform import Deformable
from gaussian_enhancer.network.depth_modulation import Unmodulated
from gaussian_enhancer.network.fuse import Mean
from support.networks import small_sif, trained, views


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "net.safetensors"
    save_weights(
        path, trained(refine=Deformable(kernel=1)), ReferenceConfig(Reprojected(tolerance=0.1), 2, 4), {"by": "test"}
    )
    return path


def test_round_trip(file):
    loaded = load_weights(file)
    network = trained(refine=Deformable(kernel=1))
    assert design_of(loaded.network) == design_of(network)
    assert loaded.reference_config == ReferenceConfig(Reprojected(tolerance=0.1), 2, 4)
    assert loaded.card == {"by": "test"}
    torch.testing.assert_close(loaded.network(views()), network(views()), rtol=0, atol=5e-3)
    assert file.stat().st_size < 2.2 * sum(p.numel() for p in network.parameters()) + 20_000


@pytest.mark.parametrize(
    "choices", [{}, {"refine": Deformable(width=4)}, {"fusion": Mean(), "modulation": Unmodulated()}]
)
def test_design_rebuilds_the_same_network(choices):
    network = small_sif(**choices)
    again = build_design(json.loads(json.dumps(design_of(network))))
    assert {n: p.shape for n, p in again.state_dict().items()} == {n: p.shape for n, p in network.state_dict().items()}


def test_unwarped_preparation_round_trips(tmp_path):
    save_weights(tmp_path / "a.safetensors", small_sif(), ReferenceConfig(Unwarped(), 2, 2), {})
    assert load_weights(tmp_path / "a.safetensors").reference_config == ReferenceConfig(Unwarped(), 2, 2)


def test_truncated_file_is_refused(file):
    file.write_bytes(file.read_bytes()[:-1000])
    with pytest.raises(InputError, match="no whole safetensors file"):
        load_weights(file)


def test_other_files_are_refused(file, tmp_path):
    for content in (b"", b"hello", b"\x00" * 4096):
        file.write_bytes(content)
        with pytest.raises(InputError, match="safetensors"):
            load_weights(file)
    save_file({"a": torch.zeros(1)}, file)
    with pytest.raises(InputError, match="format"):
        load_weights(file)
    with pytest.raises(InputError, match="neither a file nor a shipped name"):
        load_weights(tmp_path / "absent.safetensors")


@pytest.mark.parametrize(
    "change",
    [
        {"network": "os.system"},
        {"widths": [16, 16, 10**9]},
        {"widths": "1"},
        {"refine": {"kind": "Trust"}},
        {"refine": {"kind": "subprocess.Popen"}},
        {"refine": {"kind": "Deformable", "kernel": "3"}},
        {"refine": {"kind": "Deformable", "shell": 1}},
        {"widths": [16, 16, 32]},
        {"blocks": None},
    ],
)
def test_designs_are_validated(file, change):
    from safetensors import safe_open

    with safe_open(str(file), framework="pt") as opened:
        metadata = opened.metadata()
    metadata["design"] = json.dumps({**json.loads(metadata["design"]), **change})
    save_file(load_file(file), file, metadata)
    with pytest.raises(InputError, match=r"net\.safetensors"):
        load_weights(file)


def test_values_that_are_not_finite_are_refused(file):
    from safetensors import safe_open

    with safe_open(str(file), framework="pt") as opened:
        metadata = opened.metadata()
    tensors = load_file(file)
    tensors["decode.head.weight"][0] = float("nan")
    save_file(tensors, file, metadata)
    with pytest.raises(InputError, match="not finite"):
        load_weights(file)


def changed(file, **texts):
    from safetensors import safe_open

    with safe_open(str(file), framework="pt") as opened:
        metadata = opened.metadata()
    save_file(load_file(file), file, metadata | texts)


@pytest.mark.parametrize(
    ("widths", "blocks", "message"),
    [([1024, 1024, 1024], [1, 1, 1], "does not fit its own design"), ([16, 16, 24], [500, 500, 500], "1501 blocks")],
)
def test_a_design_larger_than_its_values_is_refused_before_it_is_built(file, monkeypatch, widths, blocks, message):
    design = design_of(trained(refine=Deformable(kernel=1))) | {"widths": widths, "blocks": blocks}
    changed(file, design=json.dumps(design))
    built = []
    register = torch.nn.Module.register_parameter

    def counted(module, name, parameter):
        built.append(0 if parameter is None or parameter.is_meta else parameter.numel())
        register(module, name, parameter)

    monkeypatch.setattr(torch.nn.Module, "register_parameter", counted)
    with pytest.raises(InputError, match=message):
        load_weights(file)
    assert sum(built) == 0


@pytest.mark.parametrize("card", ["[1]", "[" * 100_000, '{"a": ' + "1" * 5000 + "}", "5", "{"])
@pytest.mark.parametrize("part", ["card", "design", "reference_config"])
def test_metadata_that_is_no_mapping_is_refused(file, part, card):
    changed(file, **{part: card})
    with pytest.raises(InputError, match=rf"net\.safetensors.*{part}"):
        load_weights(file)


@pytest.mark.parametrize("dtype", [torch.int16, torch.bool, torch.float8_e4m3fn])
def test_values_of_other_types_are_refused(file, dtype):
    from safetensors import safe_open

    with safe_open(str(file), framework="pt") as opened:
        metadata = opened.metadata()
    save_file({name: value.to(dtype) for name, value in load_file(file).items()}, file, metadata)
    with pytest.raises(InputError, match="holds values of type"):
        load_weights(file)
