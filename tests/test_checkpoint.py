"""What tells weights from others: what they do, not what is told of them."""

from pathlib import Path

import pytest
import torch
from safetensors.torch import save_file

from gaussian_enhancer.align.references import ReferenceConfig
from gaussian_enhancer.checkpoint import checkpoint_digest, find_checkpoint
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.infer.weights import save_weights
from gaussian_enhancer.network.network import Network
from gaussian_enhancer.network.sif import SIF


def network(*widths: int) -> SIF:
    torch.manual_seed(0)
    return SIF(widths or (8, 8), (1, 1))


def digest(path: Path, built: Network, reference_config: ReferenceConfig | None = None, **card: object) -> str:
    save_weights(path, built, reference_config or ReferenceConfig(), card)
    return checkpoint_digest(path)


def test_another_card_is_no_other_weights(tmp_path) -> None:
    one = digest(tmp_path / "a.safetensors", network(), minutes=1.0, run="01234567")
    assert digest(tmp_path / "b.safetensors", network(), minutes=2.0, seed=3) == one
    assert (tmp_path / "a.safetensors").read_bytes() != (tmp_path / "b.safetensors").read_bytes()


def test_weights_in_bfloat16_have_a_digest(tmp_path) -> None:
    assert digest(tmp_path / "a.safetensors", network().bfloat16()) != digest(tmp_path / "b.safetensors", network())


def test_another_value_design_preparation_or_strength_is(tmp_path) -> None:
    changed = network()
    with torch.no_grad():
        changed.decode.head.bias[0] += 2**-6
    found = [
        digest(tmp_path / "w.safetensors", network()),
        digest(tmp_path / "w.safetensors", changed),
        digest(tmp_path / "w.safetensors", network(8, 12)),
        digest(tmp_path / "w.safetensors", network(), ReferenceConfig(references=1, candidates=2)),
        digest(tmp_path / "w.safetensors", network(), strength=0.5),
        digest(tmp_path / "w.safetensors", network(), strength=0.25),
    ]
    assert len(set(found)) == len(found)
    assert digest(tmp_path / "w.safetensors", network(), strength=1.0) == found[0]


def test_the_digest_is_that_of_the_same_weights_tomorrow(tmp_path) -> None:
    """Runs are found again by it."""
    save_file(
        {"b": torch.ones(2), "a": torch.arange(3.0).half()}, tmp_path / "w.safetensors", {"format": "f", "card": "{}"}
    )
    assert checkpoint_digest(tmp_path / "w.safetensors")[:16] == "fc32f167c72914b4"


def test_files_that_are_cut_have_none(tmp_path) -> None:
    digest(tmp_path / "w.safetensors", network())
    whole = (tmp_path / "w.safetensors").read_bytes()
    (tmp_path / "w.safetensors").write_bytes(whole[:-100])
    with pytest.raises(InputError, match="no whole safetensors file"):
        checkpoint_digest(tmp_path / "w.safetensors")


@pytest.mark.parametrize("card", ["{", "[]"])
def test_a_card_that_is_no_mapping_is_refused(tmp_path, card) -> None:
    save_file({"a": torch.ones(2)}, tmp_path / "w.safetensors", {"format": "f", "card": card})
    with pytest.raises(InputError, match=r"w\.safetensors: (has a card that is no mapping|its card: is no JSON)"):
        checkpoint_digest(tmp_path / "w.safetensors")


def test_no_weights_are_refused() -> None:
    unchecked = getattr(find_checkpoint, "__wrapped__", find_checkpoint)
    with pytest.raises(InputError, match="weights: is None"):
        unchecked(None)
