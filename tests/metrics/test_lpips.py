import os
from pathlib import Path

import pytest
import torch
import torchvision

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.metrics import lpips
from gaussian_enhancer.metrics.lpips import BACKBONES, VARIANTS, backbone_place, perceptual_distance
from gaussian_enhancer.scene.photos import read_photo
from support.stand_in_backbone import write_vgg

DATA = Path(os.environ.get("GAUSSIAN_ENHANCER_DATA", ""))


@pytest.fixture(autouse=True)
def empty_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty torchvision cache, so that no test depends on what this machine happens to hold."""
    monkeypatch.setattr(torch.hub, "get_dir", lambda: str(tmp_path / "hub"))
    monkeypatch.setenv("GAUSSIAN_ENHANCER_DATA", str(tmp_path / "data"))
    (tmp_path / "hub" / "checkpoints").mkdir(parents=True)
    return tmp_path / "hub" / "checkpoints"


@pytest.fixture(scope="module")
def squeeze() -> dict[str, torch.Tensor]:
    """A whole SqueezeNet's weights, random."""
    torch.manual_seed(0)
    return torchvision.models.squeezenet1_1(weights=None).state_dict()


@pytest.mark.parametrize("name", VARIANTS)
def test_without_a_backbone_the_reason_names_files_folder_and_command(name: str) -> None:
    distance = perceptual_distance(name)
    assert distance.network is None
    assert distance.reason.startswith(f"not measured: no backbone; {backbone_place(name)}, or get it with: python -c ")
    assert "into the folder $GAUSSIAN_ENHANCER_DATA/lpips or into one given as backbones=FOLDER" in distance.reason
    assert BACKBONES[VARIANTS[name][0]].features in distance.reason
    assert BACKBONES[VARIANTS[name][0]].builder in distance.reason
    with pytest.raises(InputError, match="no backbone"):
        distance.between(torch.rand(3, 40, 40), torch.rand(3, 40, 40))


@pytest.mark.parametrize("file", ["vgg16-397923af.pth", "vgg16_features.pth"])
def test_the_named_files_are_read_in_the_named_folders(tmp_path: Path, file: str) -> None:
    assert file in perceptual_distance("lpips_vgg").reason
    write_vgg(tmp_path / "given" / file, whole="features" not in file)
    draw = torch.Generator().manual_seed(1)
    pair = [torch.rand(3, 24, 32, generator=draw) for _ in range(2)]
    given = perceptual_distance("lpips_vgg", tmp_path / "given").between(*pair)
    (tmp_path / "data/lpips").mkdir(parents=True)
    (tmp_path / "given" / file).rename(tmp_path / "data/lpips" / file)
    assert perceptual_distance("lpips_vgg").between(*pair) == given > 0
    assert perceptual_distance("lpips_vgg_raw").between(*pair) != given


def test_nothing_is_downloaded(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, squeeze: dict) -> None:
    def refused(*_: object, **__: object) -> None:
        raise AssertionError("a download was tried")

    monkeypatch.setattr(torch.hub, "download_url_to_file", refused)
    assert perceptual_distance("lpips_vgg").network is None
    torch.save(squeeze, tmp_path / "weights.pth")
    assert perceptual_distance("lpips_squeeze", tmp_path / "weights.pth").network is not None


def test_the_backbone_is_found_in_a_file_a_folder_and_the_cache(
    tmp_path: Path, empty_cache: Path, squeeze: dict
) -> None:
    features = {key.removeprefix("features."): value for key, value in squeeze.items() if "features" in key}
    (tmp_path / "given").mkdir()
    torch.save(features, tmp_path / "given" / "squeezenet1_1_features.pth")
    torch.save(squeeze, tmp_path / "any.pth")
    torch.save(squeeze, empty_cache / "squeezenet1_1-b8a52dc0.pth")
    draw = torch.Generator().manual_seed(1)
    pair = [torch.rand(3, 40, 50, generator=draw) for _ in range(2)]
    places = [tmp_path / "given", tmp_path / "any.pth", None]
    found = [perceptual_distance("lpips_squeeze", place).between(*pair) for place in places]
    assert found[0] == pytest.approx(found[1], rel=1e-6)
    assert found[0] == pytest.approx(found[2], rel=1e-6)
    assert found[0] > 0
    assert perceptual_distance("lpips_squeeze").between(pair[0], pair[0]) == 0


def test_backbones_of_the_data_folder_are_found_and_what_nobody_asked_for_is_left_out(
    tmp_path: Path, squeeze: dict, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(lpips, "DEFAULT_DISTANCES", ("lpips_vgg", "lpips_squeeze"))
    assert lpips.requested_distances(None) == []
    features = {key.removeprefix("features."): value for key, value in squeeze.items() if "features" in key}
    (tmp_path / "data/lpips").mkdir(parents=True)
    torch.save(features, tmp_path / "data/lpips/squeezenet1_1_features.pth")
    assert [one.name for one in lpips.requested_distances(None)] == ["lpips_squeeze"]
    named = lpips.requested_distances(["lpips_vgg", "lpips_squeeze"])
    assert [bool(one.reason) for one in named] == [True, False]


def test_drawing_no_random_numbers(tmp_path: Path, squeeze: dict) -> None:
    torch.save(squeeze, tmp_path / "draws.pth")
    torch.manual_seed(5)
    expected = torch.rand(3)
    torch.manual_seed(5)
    perceptual_distance("lpips_squeeze", tmp_path / "draws.pth")
    assert torch.equal(torch.rand(3), expected)


def test_wrong_files_are_refused_by_name(tmp_path: Path, squeeze: dict) -> None:
    torch.save(squeeze, tmp_path / "squeeze.pth")
    with pytest.raises(InputError, match=r"squeeze\.pth: does not hold the alexnet backbone"):
        perceptual_distance("lpips_alex", tmp_path / "squeeze.pth")
    (tmp_path / "cut.pth").write_bytes((tmp_path / "squeeze.pth").read_bytes()[:5000])
    with pytest.raises(InputError, match=r"cut\.pth: cannot be read as weights"):
        perceptual_distance("lpips_squeeze", tmp_path / "cut.pth")
    with pytest.raises(InputError, match=r"none\.pth: does not exist"):
        perceptual_distance("lpips_squeeze", tmp_path / "none.pth")
    with pytest.raises(InputError, match="metric 'lpips'"):
        perceptual_distance("lpips")


def test_images_below_the_smallest_size_are_told(tmp_path: Path, squeeze: dict) -> None:
    torch.save(squeeze, tmp_path / "small.pth")
    distance = perceptual_distance("lpips_squeeze", tmp_path / "small.pth")
    assert "16x40 is smaller than the network's 17" in distance.size_reason(40, 16)
    assert distance.size_reason(17, 17) == ""
    assert distance.between(torch.rand(3, 17, 17), torch.rand(3, 17, 17)) >= 0


@pytest.mark.captures
@pytest.mark.parametrize(("name", "expected"), [("lpips_alex", (0.7219, 0.1376)), ("lpips_squeeze", (0.7110, 0.1479))])
def test_known_distances_of_the_example_images(name: str, expected: tuple[float, float]) -> None:
    folder = DATA / "lpips"
    if not (folder / "ex_ref.png").exists():
        pytest.skip("GAUSSIAN_ENHANCER_DATA names no folder with lpips/ex_ref.png")
    reference, *others = (read_photo(folder / f"ex_{which}.png") for which in ("ref", "p0", "p1"))
    distance = perceptual_distance(name, folder)
    assert [distance.between(other, reference) for other in others] == pytest.approx(expected, abs=1e-4)
