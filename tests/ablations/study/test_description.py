import dataclasses

import pytest

from ablations.study.description import (
    MethodDescription,
    SceneGroup,
    TableDescription,
    read_description,
    write_description,
)
from gaussian_enhancer.errors import InputError

TABLE = TableDescription(
    "table_2",
    "Same resolution",
    "quality",
    "as the paper's",
    {"raw": MethodDescription("3DGS", role=""), "ge": MethodDescription("GE", train=("+ablation/variant=ge",))},
    "raw",
    ("psnr", "ssim"),
    ("3dgs",),
    {"mip_nerf_360": SceneGroup("Mip-NeRF 360", ("unbounded_2000",), "procedural scenes")},
    (0, 1),
    {"3dgs": {"raw": (28.17, 0.854), "ge": None}},
)


def test_a_description_is_read_as_it_was_written(tmp_path):
    write_description(tmp_path / "t.json", TABLE)
    assert read_description(tmp_path / "t.json") == TABLE


@pytest.mark.parametrize("wrong", [{"kind": "prose"}, {"metrics": ("taste",)}, {"baseline": "ours"}])
def test_what_is_no_table_is_refused(wrong):
    with pytest.raises(Exception, match=r"prose|taste|ours"):
        dataclasses.replace(TABLE, **wrong)


@pytest.mark.parametrize("text", ["", "[]", "{}", '{"rows": {}, "datasets": {}, "colour": 1}'])
def test_damaged_descriptions_are_refused_by_name(tmp_path, text):
    (tmp_path / "t.json").write_text(text)
    with pytest.raises(InputError, match=r"t\.json"):
        read_description(tmp_path / "t.json")


def test_a_missing_description_says_how_to_make_it(tmp_path):
    with pytest.raises(InputError, match="gaussian-enhancer tables"):
        read_description(tmp_path / "t.json")
