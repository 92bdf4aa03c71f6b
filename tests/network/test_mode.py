import pytest
import torch
from hydra import compose, initialize_config_dir
from omegaconf import DictConfig, OmegaConf
from test_sif import views

from gaussian_enhancer.align.alignment import Unwarped
from gaussian_enhancer.align.references import ReferenceConfig
from gaussian_enhancer.network.deform import Deformation
from gaussian_enhancer.network.fuse import PairFusion
from gaussian_enhancer.network.output_head import Residual
from gaussian_enhancer.network.stem import Gather
from gaussian_enhancer.runs.instantiate import build
from support import paths

CONF = paths.ROOT / "conf"
ROWS = {
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
    with initialize_config_dir(str(CONF), version_base="1.3"):
        return compose("train", ["data.train=[a]", "data.validation=[b]", "size=tiny", *overrides])


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


@pytest.mark.parametrize("fusion", ["sif", "ssif_lr"])
def test_paper_mode_is_the_papers(fusion):
    cfg = composed("mode=paper", f"fusion={fusion}")
    network = build(cfg.fusion)
    for gather in (module for module in network.modules() if isinstance(module, Gather)):
        assert isinstance(gather.fuse, PairFusion)
        assert isinstance(gather.align, Deformation)
        assert isinstance(gather.align.narrow, torch.nn.Identity)
        assert not gather.reference_renders
    assert isinstance(network.output, Residual)
    assert build(cfg.reference_config) == ReferenceConfig(Unwarped(), 2, 2)
    assert list(build(cfg.loss).terms) == ["charbonnier"]
    seen = views(height=16, width=16)
    assert torch.equal(network(seen), seen.render)


def test_rows_together_cover_all_that_the_modes_differ_in():
    named = set().union(*ROWS.values())
    for name in differences(composed(), composed("mode=paper")) - {"label", "study", "logger.wandb.group"}:
        assert any(name == row or name.startswith(f"{row}.") for row in named), name


def test_variants_of_ssif_lr_compose_and_build():
    """Each is SSIF-LR but for what its name says."""
    usual = build(composed("fusion=ssif_lr").fusion)
    for variant, name in (("unshared", "share"), ("uncombined", "combine")):
        network = build(composed(f"fusion=ssif_lr_{variant}").fusion)
        assert {key for key, value in network.design.items() if value != usual.design[key]} == {name}


def test_ours_is_the_default():
    assert not differences(composed(), composed("mode=ours"))
