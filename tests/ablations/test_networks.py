import pandas as pd
import torch
from torch import nn

from ablations.benchmarks import networks
from ablations.study.markdown import markdown
from ablations.study.row_table import read_layout, row_table
from ablations.study.rows import RowFile
from gaussian_enhancer.infer.weights import NETWORKS
from gaussian_enhancer.network.network import Network
from support.job_config import initialised
from support.paths import ROOT

PAPER = "gaussian_enhancer.network.paper."


def recorded(name: str) -> pd.DataFrame:
    return networks.format_networks(RowFile(ROOT / f"docs/results/{name}.jsonl", ("fusion",)).read())


def table(rows: pd.DataFrame) -> str:
    return markdown(row_table(rows, read_layout("networks")))


class OneConvolution(Network):
    def __init__(self):
        super().__init__()
        self.conv = nn.Conv2d(3, 3, 3, padding=1, groups=3)

    def stages(self, views):
        return (self.conv(views.render), nn.functional.interpolate(self.conv(views.render), scale_factor=2))


def test_multiply_adds_are_those_of_the_convolutions_per_enhanced_pixel():
    assert networks.multiply_adds(OneConvolution(), references=0, side=8) == 2 * 27 / 4


class LooksAtValues(OneConvolution):
    def stages(self, views):
        return super().stages(views) if bool(views.render.any()) else (views.render,)


def test_a_network_that_looks_at_values_is_computed_to_be_counted():
    assert networks.multiply_adds(LooksAtValues(), references=0, side=8) == 2 * 27 / 4


def test_times_are_one_for_each_network():
    times = networks.microseconds([OneConvolution(), OneConvolution()], networks.example(8, 8, 1), rounds=2)
    assert len(times) == 2
    assert min(times) > 0


def test_record_holds_every_network_that_weights_can_name():
    rows = recorded("networks")
    names = set(rows["fusion"])
    assert len(names) == sum(not kind.__module__.startswith(PAPER) for kind in NETWORKS.values())
    page = (ROOT / "docs" / "results" / "networks.md").read_text()
    assert table(rows) in page


def test_page_on_fidelity_holds_the_cost_of_the_papers_networks_with_and_without_the_buffer():
    rows = recorded("paper_networks")
    assert table(rows) in (ROOT / "docs/fidelity.md").read_text()
    work = rows.set_index(["fusion", "size"])["giga_multiply_adds_per_megapixel"]
    for size in networks.SIZES:
        assert work["ssif_sr, paper", size] < work["ssif_sr, paper, without its buffer", size]


def test_the_papers_networks_are_built_by_their_mode():
    with initialised():
        found = list(networks.subjects(paper=True))
    assert all(type(one.network).__module__.startswith(PAPER) for one in found)
    assert len(found) == 4 * len(networks.SIZES)


def test_example_has_all_that_views_may_have():
    views = networks.example(8, 12, 2)
    assert all(value is not None for value in vars(views).values())
    assert views.fine_references.shape == (1, 2, 3, 32, 48)
    assert bool(torch.all(views.depth >= 1))
