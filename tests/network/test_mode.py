import pytest
import torch
from omegaconf import DictConfig, OmegaConf

from gaussian_enhancer.align.alignment import Unwarped
from gaussian_enhancer.align.references import ReferenceConfig
from gaussian_enhancer.cli import train
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.network.deform import Deformation
from gaussian_enhancer.network.paper.sif import PaperSIF
from gaussian_enhancer.network.paper.ssif_lr import PaperSSIFLR
from gaussian_enhancer.network.paper.ssif_sr import PaperSSIFSR
from gaussian_enhancer.network.pyramid import upsample_bicubic
from gaussian_enhancer.network.sif import SIF
from gaussian_enhancer.runs.instantiate import build
from support.job_config import job_config
from support.networks import views
from support.paths import CONF

ROWS = {
    "all": {
        "alignment",
        "coarse",
        "data.samples.reference_config",
        "fusion.fusion",
        "fusion.output",
        "fusion.reference_renders",
        "fusion.refine",
        "loss.terms",
        "reference_config",
    },
    "agreement": {
        "alignment.warp.photo_consistency",
        "reference_config.warp.photo_consistency",
        "data.samples.reference_config.warp.photo_consistency",
    },
    "alignment": {"alignment", "fusion.refine", "reference_config.warp", "data.samples.reference_config.warp"},
    "coarse": {"coarse"},
    "colour": {
        "alignment.warp.match_colour",
        "reference_config.warp.match_colour",
        "data.samples.reference_config.warp.match_colour",
    },
    "depth": {"alignment.warp.depth", "reference_config.warp.depth", "data.samples.reference_config.warp.depth"},
    "fusion": {"fusion.fusion", "reference_config.references", "data.samples.reference_config.references"},
    "objective": {"loss.terms"},
    "occlusion": {
        "alignment.warp.tolerance",
        "reference_config.warp.tolerance",
        "data.samples.reference_config.warp.tolerance",
    },
    "output": {"fusion.output"},
    "ranking": {"reference_config.candidates", "data.samples.reference_config.candidates"},
    "reference_renders": {"fusion.reference_renders"},
    "references": {"reference_config.references", "data.samples.reference_config.references"},
}
"""What each row may change beside its label; a name covers what lies below it."""


def composed(*overrides: str) -> DictConfig:
    return job_config("train", "data.train=[a]", "data.validation=[b]", "size=tiny", *overrides)


def flat(node: DictConfig) -> dict[str, object]:
    """Every value by its dotted name."""
    values: dict[str, object] = {}

    def visit(value: object, name: str) -> None:
        if isinstance(value, dict):
            for key, below in value.items():
                visit(below, f"{name}.{key}" if name else str(key))
        else:
            values[name] = value

    visit(OmegaConf.to_container(node, resolve=True), "")
    return values


def differences(a: DictConfig, b: DictConfig) -> set[str]:
    left, right = flat(a), flat(b)
    return {name for name in left.keys() | right.keys() if left.get(name, "absent") != right.get(name, "absent")}


def test_every_row_is_a_file_and_every_file_a_row():
    assert {path.stem for path in (CONF / "ablation" / "mode").glob("*.yaml")} == ROWS.keys()


@pytest.mark.parametrize("row", sorted(ROWS))
@pytest.mark.parametrize("fusion", ["sif", "ssif_lr"])
def test_each_row_changes_what_it_names_alone_and_builds(row, fusion):
    ours, other = composed(f"fusion={fusion}"), composed(f"fusion={fusion}", f"+ablation/mode={row}")
    changed = differences(ours, other) - {"label", "study", "logger.wandb.group"}
    below = {name: {c for c in changed if c == name or c.startswith(f"{name}.")} for name in ROWS[row]}
    assert all(below.values()), "a named difference is none"
    assert changed == set().union(*below.values())
    assert other.label == f"mode_{row}"
    reference_config = build(other.reference_config)
    build(other.loss)
    seen = views(height=16, width=16, references=reference_config.references)
    assert torch.equal(build(other.fusion)(seen), seen.render)


@pytest.mark.parametrize(("fusion", "kind"), [("sif", PaperSIF), ("ssif_lr", PaperSSIFLR), ("ssif_sr", PaperSSIFSR)])
def test_paper_mode_is_the_papers(fusion, kind):
    cfg = composed("mode=paper", f"fusion={fusion}")
    network = build(cfg.fusion)
    assert type(network) is kind
    deformations = [module for module in network.modules() if isinstance(module, Deformation)]
    assert deformations
    for deformation in deformations:
        assert deformation.reach is None
        assert isinstance(deformation.narrow, torch.nn.Identity)
    assert build(cfg.reference_config) == ReferenceConfig(Unwarped(), 2, 2)
    assert list(build(cfg.loss).terms) == ["charbonnier"]
    assert cfg.coarse == 0
    seen = views(height=16, width=16)
    assert torch.equal(network(seen), upsample_bicubic(seen.render, network.scale))


@pytest.mark.parametrize("fusion", ["nafnet", "ssif_lr_unshared"])
def test_paper_mode_refuses_a_network_that_is_not_the_papers(fusion):
    cfg = composed("mode=paper", f"fusion={fusion}")
    with pytest.raises(InputError, match="mode=paper"):
        train._network(cfg)


def test_ours_keeps_its_networks_and_their_bounded_offsets():
    cfg = composed("alignment=deformable", "fusion=sif")
    network = build(cfg.fusion)
    assert type(network) is SIF
    assert network.gather.align.reach == 10.0


OWN = {"fusion._target_", "alignment.refine.reach", "fusion.refine.reach", "faithful"}
"""What the paper's own networks differ in, beside what the rows name: no single row of ours could have it."""


def test_rows_together_cover_all_that_the_modes_differ_in_but_the_networks():
    named = ROWS["all"]
    for name in differences(composed(), composed("mode=paper")) - {"label", "study", "logger.wandb.group"} - OWN:
        assert any(name == row or name.startswith(f"{row}.") for row in named), name


def test_variants_of_ssif_lr_compose_and_build():
    """Each is SSIF-LR but for what its name says."""
    usual = build(composed("fusion=ssif_lr").fusion)
    for variant, name in (("unshared", "share"), ("uncombined", "combine")):
        network = build(composed(f"fusion=ssif_lr_{variant}").fusion)
        assert {key for key, value in network.design.items() if value != usual.design[key]} == {name}


def test_ours_is_the_default():
    assert not differences(composed(), composed("mode=ours"))
