"""A configuration on disk opens scenes and nothing else."""

from pathlib import Path
from typing import Any

import pytest
import yaml

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.scene.stored import read_scene_values, scene_from_values

PROCEDURAL = "gaussian_enhancer.scene.procedural.procedural_scene"
CAPTURE = "gaussian_enhancer.scene.capture.open_capture"
SPLIT = "gaussian_enhancer.scene.splits.Split"


def procedural(**values: Any) -> dict[str, Any]:
    return {"_target_": PROCEDURAL, "family": "object", "seed": 3, "height": 24, "width": 32, "views": 6, **values}


def test_a_scene_is_opened_with_its_split() -> None:
    scene = scene_from_values(procedural(points=0, split={"_target_": SPLIT, "test_every": 3}))
    assert (len(scene.train), len(scene.test)) == (4, 2)


def hostile(mark: Path) -> list[dict[str, Any]]:
    """Configurations that wrote a file, or deleted one, before loaders were a closed list."""
    write = {"_target_": "pathlib.Path.write_text", "_args_": [{"_target_": "pathlib.Path", "_args_": [str(mark)]}, ""]}
    copy = {"_target_": "gaussian_enhancer.scene.extract.shutil.copyfile", "src": "/etc/hostname", "dst": str(mark)}
    load = {"_target_": "numpy.load", "file": str(mark), "allow_pickle": True}
    return [
        procedural(background=[write]),
        procedural(split=copy),
        procedural(split={**copy, "test_every": 8}),
        procedural(device=load),
        procedural(_partial_=True),
        procedural(_args_=[write]),
        {"_target_": CAPTURE, "path": write},
        {"_target_": CAPTURE, "path": str(mark.parent), "background": [write, 0, 0]},
        {"_target_": CAPTURE, "path": str(mark.parent), "downscale": "${oc.env:HOME}"},
        copy,
        write,
        load,
        {"_target_": ["gaussian_enhancer.scene.capture.open_capture"]},
        {},
    ]


@pytest.mark.parametrize("number", range(14))
def test_nothing_else_is_called(number: int, tmp_path: Path) -> None:
    mark = tmp_path / "mark"
    with pytest.raises(InputError):
        scene_from_values(hostile(mark)[number])
    assert not mark.exists()


def test_a_run_that_names_code_is_refused_before_any_of_it_runs(tmp_path: Path) -> None:
    mark = tmp_path / "mark"
    for values in hostile(mark):
        (tmp_path / "config.yaml").write_text(yaml.safe_dump({"scene": values}))
        with pytest.raises(InputError):
            scene_from_values(read_scene_values(tmp_path / "config.yaml"))
        assert not mark.exists()


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("scene: !!python/object/apply:os.system ['true']", "no YAML"),
        ("[1, 2", "no YAML"),
        ("- 1", "names no scene"),
        ("scene: 3", "names no scene"),
        ("[" * 5000, "no YAML"),
        ("a: " + "x" * 2**20, "bytes"),
    ],
)
def test_what_is_no_configuration_is_refused(content: str, words: str, tmp_path: Path) -> None:
    file = tmp_path / "config.yaml"
    file.write_text(content)
    with pytest.raises(InputError, match=words):
        read_scene_values(file)


def test_values_keep_their_types() -> None:
    for change in ({"seed": "3"}, {"seed": 3.5}, {"height": "24"}, {"family": 4}, {"nonsense": 1}, {"seed": True}):
        with pytest.raises(InputError):
            scene_from_values(procedural(**change))
