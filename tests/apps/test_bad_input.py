"""What users get wrong: one line that names file, value and remedy, exit code 2, and nothing half-written."""

import json
import math
import resource
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from gaussian_enhancer.apps import cli

WIDTH, HEIGHT, VIEWS = 32, 24, 10
Refused = Callable[..., str]


@pytest.fixture(autouse=True)
def elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Work in an empty folder, where whatever is left behind can be seen."""
    monkeypatch.chdir(tmp_path)
    warnings.simplefilter("ignore", UserWarning)


@pytest.fixture
def refused(capsys: pytest.CaptureFixture[str]) -> Refused:
    """Run a command that must be refused; returns the line."""

    def run(*words: str, allowed: tuple[str, ...] = ()) -> str:
        before = contents()
        capsys.readouterr()
        with pytest.raises(SystemExit) as stop:
            cli.main(list(words))
        lines = [line for line in capsys.readouterr().err.splitlines() if line.strip()]
        assert stop.value.code == 2, lines
        assert len(lines) == 1, lines
        assert lines[0].startswith("gaussian-enhancer: "), lines
        assert lines[0].count("; ") >= 1, "a remedy is missing"
        left = {path: data for path, data in contents().items() if not path.endswith(allowed or ("\0",))}
        assert left == before
        return lines[0]

    return run


def contents() -> dict[str, bytes]:
    return {str(path): path.read_bytes() for path in Path().rglob("*") if path.is_file()}


@contextmanager
def full_disk(room: int) -> Iterator[None]:
    """Let the kernel refuse to write any file beyond ``room`` bytes, as a full disk would."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (room, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


def save(path: Path | str, size: tuple[int, int] = (WIDTH, HEIGHT), seed: int = 0) -> Path:
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    pixels = np.random.default_rng(seed).integers(0, 255, (size[1], size[0], 3), dtype=np.uint8)
    Image.fromarray(pixels).save(path)
    return path


def cut(path: Path | str, share: float = 0.5) -> None:
    data = Path(path).read_bytes()
    Path(path).write_bytes(data[: int(len(data) * share)])


def ring(i: int) -> list[list[float]]:
    """Camera-to-world in OpenGL axes: on a circle of radius 3, looking at the origin."""
    angle = 2 * math.pi * i / VIEWS
    c, s = math.cos(angle), math.sin(angle)
    return [[c, 0, s, 3 * s], [0, 1, 0, 0], [-s, 0, c, 3 * c], [0, 0, 0, 1]]


@pytest.fixture
def capture() -> Path:
    """A capture of ten photos, two of them held out, that every job accepts."""
    frames = []
    for i in range(VIEWS):
        save(f"capture/images/{i}.png", seed=i)
        frames.append({"file_path": f"images/{i}.png", "transform_matrix": ring(i)})
    lens = {"fl_x": 30.0, "fl_y": 30.0, "cx": WIDTH / 2, "cy": HEIGHT / 2, "w": WIDTH, "h": HEIGHT}
    Path("capture/transforms.json").write_text(json.dumps({**lens, "frames": frames}))
    return Path("capture")


# measure ----------------------------------------------------------------------------------------------------------


@pytest.fixture
def measured() -> tuple[str, ...]:
    """Folders that ``measure`` accepts, and its command."""
    for name in ("a", "b"):
        save(f"images/{name}.png", seed=1)
        save(f"photos/{name}.png", seed=2)
    return ("measure", "images=images", "photos=photos", "lpips=[]", "output=out")


def test_measure_accepts_what_the_cases_below_spoil(measured: tuple[str, ...]) -> None:
    cli.main(list(measured))
    assert {p.name for p in Path("out").iterdir()} >= {"records.jsonl", "summary.md", "done"}


def test_measure_truncated_image(measured: tuple[str, ...], refused: Refused) -> None:
    cut("images/b.png")
    assert "images/b.png: cannot be decoded" in refused(*measured)


def test_measure_missing_folder(measured: tuple[str, ...], refused: Refused) -> None:
    assert "nowhere: is no folder" in refused(*measured, "images=nowhere")


def test_measure_empty_folder(measured: tuple[str, ...], refused: Refused) -> None:
    Path("empty").mkdir()
    assert "empty: holds no image" in refused(*measured, "photos=empty")


def test_measure_empty_image(measured: tuple[str, ...], refused: Refused) -> None:
    Path("images/a.png").write_bytes(b"")
    assert "images/a.png: is empty (0 bytes)" in refused(*measured)


def test_measure_image_without_photo(measured: tuple[str, ...], refused: Refused) -> None:
    Path("photos/a.png").unlink()
    assert "images/a.png: has no photo in photos" in refused(*measured)


def test_measure_sizes_that_differ(measured: tuple[str, ...], refused: Refused) -> None:
    save("photos/b.png", (WIDTH, HEIGHT + 1))
    assert f"photos/b.png: is {WIDTH}x{HEIGHT + 1} where images/b.png is {WIDTH}x{HEIGHT}" in refused(*measured)


@pytest.mark.parametrize(
    ("words", "found"),
    [
        (("images=null",), "no images to measure"),
        (("run=out",), "together with images"),
        (("lpips=[lpips_ale]",), "metric 'lpips_ale': is unknown"),
        (("lpips=[lpips_alex]", "backbones=none.pth"), "none.pth: does not exist"),
        (("unmatched=ignore",), "unmatched: is 'ignore'"),
        (("background=[0,0]",), "background: is [0, 0]"),
        (("background=[red,0,0]",), "background: is ['red', 0, 0]"),
        (("masks=photos", "raw=none"), "none: is no folder"),
    ],
)
def test_measure_options(measured: tuple[str, ...], refused: Refused, words: tuple[str, ...], found: str) -> None:
    assert found in refused(*measured, *words)


def test_measure_run_without_renders(capture: Path, refused: Refused) -> None:
    assert "capture: holds no test/ours_<step>/renders" in refused("measure", f"run={capture}")


def test_measure_full_disk(measured: tuple[str, ...], refused: Refused) -> None:
    with full_disk(900):
        line = refused(*measured, allowed=("config.yaml",))
    assert "records.jsonl: cannot be written (File too large)" in line


def test_measure_no_space(measured: tuple[str, ...], refused: Refused, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "write_text", full)
    assert "out/config.yaml: cannot be written (No space left on device)" in refused(*measured)


# fit --------------------------------------------------------------------------------------------------------------

FAST = ("settings.steps=2", "settings.init=random", "runtime.progress=false", "runtime.threads=1")


def fit(capture: Path, *words: str) -> tuple[str, ...]:
    return ("fit", f"scene.path={capture}", *FAST, *words)


def edit(capture: Path, change: Callable[[dict], object]) -> None:
    file = capture / "transforms.json"
    content = json.loads(file.read_text())
    change(content)
    file.write_text(json.dumps(content))


def test_fit_accepts_what_the_cases_below_spoil(capture: Path) -> None:
    cli.main(list(fit(capture, "output=out")))
    assert {p.name for p in Path("out").iterdir()} >= {"splat.ply", "cameras.json", "records.jsonl", "done"}


@pytest.mark.parametrize("number", [0, 3])  # 0 is held out, 3 is trained on
def test_fit_truncated_photo(capture: Path, refused: Refused, number: int) -> None:
    cut(capture / f"images/{number}.png")
    assert f"images/{number}.png: cannot be decoded" in refused(*fit(capture))


@pytest.mark.parametrize("number", [0, 3])
def test_fit_missing_photo(capture: Path, refused: Refused, number: int) -> None:
    (capture / f"images/{number}.png").unlink()
    line = refused(*fit(capture))
    assert f"{number}.png" in line
    assert "missing=drop" in line


def test_fit_photo_of_another_size(capture: Path, refused: Refused) -> None:
    save(capture / "images/3.png", (WIDTH, HEIGHT + 5))
    line = refused(*fit(capture))
    assert "3.png" in line
    assert f"{WIDTH}x{HEIGHT + 5}" in line


def test_fit_one_photo(capture: Path, refused: Refused) -> None:
    edit(capture, lambda content: content.update(frames=content["frames"][:1]))
    assert "photo" in refused(*fit(capture))


def test_fit_no_frames(capture: Path, refused: Refused) -> None:
    edit(capture, lambda content: content.update(frames=[]))
    assert "transforms.json" in refused(*fit(capture))


def test_fit_camera_that_is_not_finite(capture: Path, refused: Refused) -> None:
    edit(capture, lambda content: content["frames"][3]["transform_matrix"][0].__setitem__(0, math.nan))
    assert "transforms.json" in refused(*fit(capture))


def test_fit_cut_json(capture: Path, refused: Refused) -> None:
    cut(capture / "transforms.json")
    assert "transforms.json" in refused(*fit(capture))


def test_fit_empty_folder(refused: Refused) -> None:
    Path("empty").mkdir()
    assert "empty: is no capture that can be recognised (it holds nothing)" in refused(*fit(Path("empty")))


def test_fit_missing_folder(refused: Refused) -> None:
    assert "nowhere: is no folder" in refused(*fit(Path("nowhere")))


def test_fit_without_a_scene(refused: Refused) -> None:
    assert "scene.path: is mandatory" in refused("fit", *FAST)


@pytest.mark.parametrize(
    ("words", "found"),
    [
        (("settings.steps=0",), "steps"),
        (("settings.init=magic",), "magic"),
        (("settings.sh_degree=4",), "degree"),
        (("scene.downscale=0",), "downscale"),
        (("scene.split.test_every=1",), "split"),
        (("settings.snapshots=[2.0]",), "snapshots"),
        (("settings.max_gaussians=0",), "gaussians"),
        (("runtime.device=tpu",), "runtime.device"),
        (("runtime.threads=0",), "runtime.threads"),
    ],
)
def test_fit_options(capture: Path, refused: Refused, words: tuple[str, ...], found: str) -> None:
    assert found in refused(*fit(capture, *words))


@pytest.mark.parametrize("room", [700, 3000, 20_000])
def test_fit_full_disk(capture: Path, room: int, capsys: pytest.CaptureFixture[str]) -> None:
    """Whatever is there after a refusal is whole, and the fit goes on once there is room."""
    with full_disk(room), pytest.raises(SystemExit) as stop:
        cli.main(list(fit(capture, "output=out")))
    lines = [line for line in capsys.readouterr().err.splitlines() if line.strip()]
    assert (stop.value.code, len(lines)) == (2, 1), lines
    assert "cannot be written (" in lines[0]
    assert not list(Path("out").rglob(".*"))
    assert not Path("out/done").exists()
    for picture in Path("out").rglob("*.png"):
        Image.open(picture).load()
    for depth in Path("out").rglob("*.npy"):
        assert np.load(depth).shape == (HEIGHT, WIDTH)
    cli.main(list(fit(capture, "output=out")))
    assert Path("out/done").is_file()


def test_fit_damaged_checkpoint(capture: Path, refused: Refused) -> None:
    Path("out").mkdir()
    Path("out/checkpoint.pt").write_bytes(b"PK\x03\x04 no checkpoint")
    assert "out/checkpoint.pt: cannot be read" in refused(*fit(capture, "output=out"), allowed=("config.yaml",))
