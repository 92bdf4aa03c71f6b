import json

import pytest
import torch

from ablations.scripts import ship
from gaussian_enhancer.align.references import ReferenceConfig
from gaussian_enhancer.infer.change_confidence import ChangeConfidence
from gaussian_enhancer.infer.weights import load_weights, save_weights
from gaussian_enhancer.network.cascade import Cascade
from gaussian_enhancer.network.ssif_lr import SSIFLR
from gaussian_enhancer.network.ssif_sr import SSIFSR

SMALL = {"widths": (8, 8, 8), "blocks": (1, 1, 1)}
TEXTS = ["name=new", "helps=much", "harms=little"]


def test_a_cascade_is_shipped_with_the_first_network_that_is_named(tmp_path, monkeypatch, job, capsys):
    shipped = tmp_path / "shipped"
    shipped.mkdir()
    monkeypatch.setattr(ship, "SHIPPED_FOLDER", shipped)
    torch.manual_seed(0)
    first, second = SSIFLR(widths=(16, 8, 8), blocks=(1, 1, 1)), SSIFSR(**SMALL)
    for name, network in (("lr", first), ("sr", second), ("both", Cascade(SSIFLR(**SMALL), second))):
        config = ReferenceConfig(references=2 if name == "lr" else 3, fine=name != "lr")
        card = {"run": name, "steps": 3, "credits": ["whole", name]}
        confidence = ChangeConfidence(8) if name == "lr" else None
        save_weights(tmp_path / f"{name}.safetensors", network, config, card, confidence)
    first_words = [f"first={tmp_path}/lr.safetensors", "+card.data=new", *TEXTS]
    job("ship", f"weights={tmp_path}/both.safetensors", *first_words)
    found = load_weights(shipped / "new.safetensors")
    assert isinstance(found.network, Cascade)
    for name, value in first.state_dict().items():
        assert torch.equal(found.network.first.state_dict()[name], value.half().float())
    assert found.card["first"] == {"name": None, "run": "lr", "steps": 3, "data": None}
    assert found.card["credits"] == ["whole", "both", "lr"]
    assert found.confidence is not None
    assert found.confidence.hidden == 8
    assert (found.reference_config.references, found.reference_config.fine) == (2, True)
    assert found.card["run"] == "both"
    assert found.card["data"] == "new"
    assert json.loads((shipped / "new.json").read_text())["design"]["first"]["widths"] == [16, 8, 8]
    before = (shipped / "new.json").read_text()
    with pytest.raises(SystemExit):
        job("ship", f"weights={tmp_path}/sr.safetensors", *first_words)
    assert "are of SSIFSR; give those of a cascade with first=" in capsys.readouterr().err
    assert (shipped / "new.json").read_text() == before


def test_other_numbers_of_references_and_candidates_are_shipped_with_the_weights(tmp_path, monkeypatch, job):
    shipped = tmp_path / "shipped"
    shipped.mkdir()
    monkeypatch.setattr(ship, "SHIPPED_FOLDER", shipped)
    save_weights(
        tmp_path / "lr.safetensors", SSIFLR(**SMALL), ReferenceConfig(references=3, candidates=5), {"steps": 3}
    )
    job("ship", f"weights={tmp_path}/lr.safetensors", "references=2", "candidates=3", *TEXTS)
    config = load_weights(shipped / "new.safetensors").reference_config
    assert (config.references, config.candidates) == (2, 3)
    card = json.loads((shipped / "new.json").read_text())["reference_config"]
    assert (card["references"], card["candidates"]) == (2, 3)
