"""What users get wrong: one line that names file, value and remedy, exit code 2, and nothing half-written."""

import json
import math
import os
import resource
import shutil
import sys
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from filelock import FileLock
from PIL import Image

from gaussian_enhancer.cli import main as cli
from gaussian_enhancer.errors import InputError
from support.failures import fill_disk

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
        ignored = (*allowed, "failed") if allowed else ("\0",)  # where a run's folder stays, it says why it failed
        written_files = {path: data for path, data in contents().items() if not path.endswith(ignored)}
        assert written_files == before
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


def write_capture(folder: Path) -> Path:
    """A capture of ten photos, two of them held out, that every job accepts."""
    frames = []
    for i in range(VIEWS):
        save(folder / f"images/{i}.png", seed=i)
        frames.append({"file_path": f"images/{i}.png", "transform_matrix": ring(i)})
    lens = {"fl_x": 30.0, "fl_y": 30.0, "cx": WIDTH / 2, "cy": HEIGHT / 2, "w": WIDTH, "h": HEIGHT}
    (folder / "transforms.json").write_text(json.dumps({**lens, "frames": frames}))
    return folder


@pytest.fixture
def capture() -> Path:
    return write_capture(Path("capture"))


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


SPOILT: dict[str, tuple[Callable[[], object], tuple[str, ...], str]] = {
    "a truncated image": (lambda: cut("images/b.png"), (), "images/b.png: cannot be decoded"),
    "an empty image": (lambda: Path("images/a.png").write_bytes(b""), (), "images/a.png: is empty (0 bytes)"),
    "an image without photo": (Path("photos/a.png").unlink, (), "images/a.png: has no photo in photos"),
    "a missing folder": (lambda: None, ("images=nowhere",), "nowhere: is no folder"),
    "an empty folder": (Path("empty").mkdir, ("photos=empty",), "empty: holds no image"),
    "sizes that differ": (
        lambda: save("photos/b.png", (WIDTH, HEIGHT + 1)),
        (),
        f"photos/b.png: is {WIDTH}x{HEIGHT + 1} where images/b.png is {WIDTH}x{HEIGHT}",
    ),
}


@pytest.mark.parametrize("case", SPOILT)
def test_measure_files(measured: tuple[str, ...], refused: Refused, case: str) -> None:
    spoil, words, message = SPOILT[case]
    spoil()
    assert message in refused(*measured, *words)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("images=null",), "no images to measure"),
        (("run=out",), "together with images"),
        (("lpips=[lpips_ale]",), "metric 'lpips_ale': is unknown"),
        (("lpips=[lpips_alex]", "backbones=none.pth"), "none.pth: does not exist"),
        (("unmatched=ignore",), "unmatched: is 'ignore'"),
        (("background=[0,0]",), "background: is [0, 0]"),
        (("background=[red,0,0]",), "background: is ['red', 0, 0]"),
        (("masks=photos", "raw=none"), "none: is no folder"),
        (("step=7",), "step: was given beside images"),
        (("raw=photos", "variant=mine"), "variant: is 'mine' beside raw"),
        (("images=null", "photos=null", "run=out", "masks=photos"), "masks: was given beside run"),
        (("images=null", "photos=null", "run=out", "variant=x"), "variant: was given beside run"),
        (("images=null", "photos=null", "run=out", "unmatched=drop"), "unmatched: was given beside run"),
    ],
)
def test_measure_options(measured: tuple[str, ...], refused: Refused, words: tuple[str, ...], message: str) -> None:
    assert message in refused(*measured, *words)


def test_measure_run_without_renders(capture: Path, refused: Refused) -> None:
    assert "capture: holds no test/ours_<step>/renders" in refused("measure", f"run={capture}")


def test_measure_full_disk(measured: tuple[str, ...], refused: Refused) -> None:
    with full_disk(900):
        line = refused(*measured, allowed=("config.yaml",))
    assert "records.jsonl: cannot be written (File too large)" in line


def test_measure_no_space(measured: tuple[str, ...], refused: Refused, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Path, "write_text", fill_disk)
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


def test_fit_accepts_what_the_cases_below_spoil(capture: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for reused in (False, True):
        cli.main(list(fit(capture, "output=out")))
        assert ("made by an earlier call" in capsys.readouterr().err.replace("\n", " ")) == reused
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
    assert "scene.missing=drop" in line
    if number == 3:
        cli.main([*fit(capture), "scene.missing=drop", "output=out"])
        assert Path("out/done").is_file()


def frames(change: Callable[[list], object]) -> Callable[[Path], None]:
    """Change the frames of a capture."""
    return lambda capture: edit(capture, lambda content: content.update(frames=change(content["frames"])))


SPOILT_CAPTURES: dict[str, tuple[Callable[[Path], object], tuple[str, ...]]] = {
    "a photo of another size": (
        lambda capture: save(capture / "images/3.png", (WIDTH, HEIGHT + 5)),
        ("3.png", f"{WIDTH}x{HEIGHT + 5}"),
    ),
    "one photo": (frames(lambda entries: entries[:1]), ("photo",)),
    "no frames": (frames(lambda entries: []), ("transforms.json",)),
    "a camera that is not finite": (
        lambda capture: edit(capture, lambda c: c["frames"][3]["transform_matrix"][0].__setitem__(0, math.nan)),
        ("transforms.json",),
    ),
    "cut json": (lambda capture: cut(capture / "transforms.json"), ("transforms.json",)),
}


@pytest.mark.parametrize("case", SPOILT_CAPTURES)
def test_fit_captures(capture: Path, refused: Refused, case: str) -> None:
    spoil, texts = SPOILT_CAPTURES[case]
    spoil(capture)
    line = refused(*fit(capture))
    assert all(text in line for text in texts), line


def test_fit_empty_folder(refused: Refused) -> None:
    Path("empty").mkdir()
    assert "empty: is no capture that can be recognised (it holds nothing)" in refused(*fit(Path("empty")))


def test_fit_missing_folder(refused: Refused) -> None:
    assert "nowhere: is no folder" in refused(*fit(Path("nowhere")))


def test_fit_without_a_scene(refused: Refused) -> None:
    assert "scene.path: is mandatory" in refused("fit", *FAST)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("settings.steps=0",), "steps"),
        (("settings.steps=1.5",), "settings.steps: is 1.5; give a whole number"),
        (("settings.steps=nan",), "settings.steps: is nan; give a whole number"),
        (("settings.steps=abc",), "settings.steps: is 'abc'; give a whole number"),
        (("+settings.ssim_weight=nan",), "settings.ssim_weight: is nan; give a finite number"),
        (("scene.downscale=abc",), "scene.downscale: is 'abc'; give a number"),
        (("scene.nothing=1",), "scene.nothing: is no option of fit"),
        (("scene=nowhere",), "scene: has no choice 'nowhere'; choose capture,"),
        (("profile=abc",), "profile: is 'abc'; give true or false"),
        (("output=" + "a" * 300,), "with names of at most 255"),
        (("output=a=b",), "override output=a=b: cannot be parsed"),
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
def test_fit_options(capture: Path, refused: Refused, words: tuple[str, ...], message: str) -> None:
    assert message in refused(*fit(capture, *words))


def test_an_option_of_swept_scenes_is_part_of_the_sweep(refused: Refused) -> None:
    """Hydra would set it before it knows the scenes, of which it would be no option."""
    message = refused("fit", "-m", "scene=unbounded,outdoor", "scene.seed=3", allowed=("multirun.yaml",))
    assert "scene.seed: cannot be set beside the sweep scene=unbounded,outdoor" in message
    assert "make it part of the sweep: 'scene.seed=choice(VALUE)'" in message


@pytest.mark.parametrize("word", ["settings.steps=abc", "scene.downscale=abc", "runtime.threads=0", "nothing=1"])
def test_fit_options_in_a_sweep(capture: Path, refused: Refused, word: str) -> None:
    assert word.partition("=")[0] in refused(*fit(capture, "-m", word), allowed=("multirun.yaml",))


def test_fit_that_fails_leaves_nothing(capture: Path, refused: Refused, monkeypatch: pytest.MonkeyPatch) -> None:
    def lost(*_: object, **__: object) -> None:
        raise InputError("fit", "lost all Gaussians", "lower densification.opacity")

    monkeypatch.setattr("gaussian_enhancer.cli.fit.fit", lost)
    assert "lost all Gaussians" in refused(*fit(capture, "output=out"))
    assert not Path("out").exists()
    assert "lost all Gaussians" in refused(*fit(capture))
    assert not Path("runs").exists()


def test_fit_into_the_folder_of_another_fit(capture: Path, refused: Refused) -> None:
    """Also where that one is not finished: it would go on in what is not its own."""
    cli.main(list(fit(capture, "output=out")))
    assert "out: holds another finished run" in refused(*fit(capture, "output=out", "settings.seed=1"))
    Path("out/done").unlink()
    line = refused(*fit(capture, "output=out", "settings.seed=1"))
    assert "out: holds an unfinished run of another configuration" in line


@pytest.mark.parametrize("name", ["splat.ply", "cameras.json"])
def test_a_splat_of_the_user_is_not_replaced(capture: Path, refused: Refused, name: str) -> None:
    Path("mine").mkdir()
    Path("mine", name).write_bytes(b"precious")
    assert f"mine/{name}: belongs to no run of this program" in refused(*fit(capture, "output=mine"))


def test_two_fits_into_one_folder(capture: Path, refused: Refused) -> None:
    Path("out").mkdir()
    with FileLock("out/.lock"):  # another process's, as far as this one knows
        line = refused(*fit(capture, "output=out"))
        assert "out: is being written by another process" in line
        assert "out: is being written by another process" in refused(*enhance("run=nowhere", "output=out"))


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


# enhance ----------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def inputs_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A capture, a fit of it and the weights of an untrained network; copied by each case that spoils it."""
    from gaussian_enhancer.align.references import ReferenceConfig
    from gaussian_enhancer.infer.weights import save_weights
    from gaussian_enhancer.network.sif import SIF
    from gaussian_enhancer.scene.transforms import load_transforms
    from gaussian_enhancer.splat.fit.fit import fit as fit_splat
    from gaussian_enhancer.splat.fit.settings import FitSettings
    from gaussian_enhancer.splat.methods import ThreeDGS

    folder = tmp_path_factory.mktemp("inputs_folder")
    write_capture(folder / "capture")
    settings = FitSettings(steps=2, init="random", snapshots=())
    fit_splat(load_transforms(folder / "capture"), ThreeDGS(), folder / "fitted", settings, progress=False)
    save_weights(
        folder / "w.safetensors", SIF(widths=(16, 16, 24), blocks=(1, 1, 1)), ReferenceConfig(), {"by": "test"}
    )
    return folder


@pytest.fixture
def workplace(inputs_folder: Path) -> None:
    shutil.copytree(inputs_folder, Path(), dirs_exist_ok=True)


def enhance(*words: str) -> tuple[str, ...]:
    return ("enhance", "weights=w.safetensors", "runtime.progress=false", "runtime.threads=1", *words)


FORMS = {
    "run": enhance("run=fitted"),
    "gaussians": enhance("gaussians=fitted/splat.ply", "scene=transforms", "scene.path=capture"),
    "renders": enhance("renders=fitted/test/ours_2/renders", "photos=fitted/train/ours_2/gt"),
}
TARGET = "test/ours_2/renders/0.png"


@pytest.mark.parametrize("form", FORMS)
def test_enhance_accepts_what_the_cases_below_spoil(workplace: None, form: str) -> None:
    cli.main([*FORMS[form], "output=out"])
    assert [p.name for p in sorted(Path("out").iterdir()) if p.is_file()] == ["0.png", "8.png"]


@pytest.mark.parametrize("distil", ["false", "true"])
@pytest.mark.parametrize(
    ("word", "name"), [("precision=fp16", "precision"), ("tile=100", "tile"), ("strength=2", "strength")]
)
def test_options_are_refused_before_anything_is_computed(
    workplace: None, refused: Refused, monkeypatch: pytest.MonkeyPatch, word: str, name: str, distil: str
) -> None:
    def compute(*_: object, **__: object) -> None:
        raise AssertionError("computed")

    monkeypatch.setattr("gaussian_enhancer.runs.enhancement.recover_geometry", compute)
    monkeypatch.setattr("gaussian_enhancer.cli.distil.distil_run", compute)
    form = "run" if distil == "true" else "renders"
    assert f"gaussian-enhancer: {name}: " in refused(*FORMS[form], word, f"distil={distil}")


def test_distil_refuses_a_capture_beside_a_run(workplace: None, refused: Refused) -> None:
    line = refused("distil", "run=fitted", "scene=transforms", "scene.path=nowhere")
    assert "scene: was given beside run; leave scene out" in line


def test_an_output_that_is_a_file_is_refused(workplace: None, refused: Refused) -> None:
    assert "w.safetensors: cannot be written: it is a file" in refused(*FORMS["run"], "output=w.safetensors")


def test_a_report_of_nothing_is_refused(refused: Refused) -> None:
    assert "measured" in refused("report")


def test_weights_of_the_demo_are_looked_for_first(refused: Refused) -> None:
    assert "weights nope: is neither a file nor a shipped name" in refused("demo", "weights=nope")


@pytest.mark.parametrize("job", ["enhance", "video", "view", "distil"])
def test_jobs_that_enhance_refuse_unknown_options_that_were_added(refused: Refused, job: str) -> None:
    line = refused(job, "run=fitted", "+max_refs=2")
    assert f"options of {job}: names 'max_refs'; choose from " in line
    assert "max_references" in line


@pytest.mark.parametrize("job", ["demo", "fit", "simulate", "measure", "report", "export", "quality", "tradeoff"])
def test_jobs_that_do_not_train_refuse_unknown_options_that_were_added(refused: Refused, job: str) -> None:
    line = refused(job, "+stesp=2")
    assert f"options of {job}: names 'stesp'; choose from " in line


@pytest.mark.parametrize(
    ("form", "file"),
    [
        ("run", TARGET),
        ("run", "test/ours_2/renders/8.png"),
        ("run", "train/ours_2/gt/3.png"),
        ("renders", "test/ours_2/renders/8.png"),
    ],
)
def test_enhance_truncated_image(workplace: None, refused: Refused, form: str, file: str) -> None:
    """Also the last of several: the first ones must not be written before it is found out."""
    cut(Path("fitted", file))  # a plan may leave photos unread: a fit of two steps has no depth to warp them through
    assert f"fitted/{file}: cannot be decoded" in refused(*FORMS[form], "plan=full", "output=out")
    assert f"fitted/{file}: cannot be decoded" in refused(*FORMS[form], "plan=full")


@pytest.mark.parametrize("form", ["run", "renders"])
def test_enhance_empty_image(workplace: None, refused: Refused, form: str) -> None:
    Path("fitted", TARGET).write_bytes(b"")
    assert f"fitted/{TARGET}: is empty (0 bytes)" in refused(*FORMS[form])


@pytest.mark.parametrize("part", ["depth", "alpha"])
def test_enhance_run_with_a_part_cut(workplace: None, refused: Refused, part: str) -> None:
    file = next(Path("fitted/test/ours_2", part).iterdir())
    cut(file)
    assert f"{file}: cannot be" in refused(*FORMS["run"])


def without_first_camera() -> None:
    file = Path("fitted/cameras.json")
    file.write_text(json.dumps(json.loads(file.read_text())[1:]))


SPOILT_RUNS: dict[str, tuple[str, Callable[[], object], str]] = {
    "a photo missing": (
        "run",
        Path("fitted/test/ours_2/gt/0.png").unlink,
        "fitted/test/ours_2/gt: has no photo for the render 0.png",
    ),
    "depth missing": ("run", Path("fitted/test/ours_2/depth/0.npy").unlink, "has no depth for 0.png"),
    "a camera missing": ("run", without_first_camera, "fitted/cameras.json: lacks 1 cameras, first '0'"),
    "cameras cut": ("run", lambda: cut("fitted/cameras.json"), "fitted/cameras.json: "),
    "no references": ("run", lambda: shutil.rmtree("fitted/train"), "no photo"),
    "sizes that differ": (
        "run",
        lambda: save("fitted/test/ours_2/gt/0.png", (WIDTH + 1, HEIGHT)),
        f"gt/0.png: is {WIDTH + 1}x{HEIGHT} but its render 0.png",
    ),
    "weights cut": ("run", lambda: cut("w.safetensors", 0.9), "w.safetensors: "),
    "splat cut": ("gaussians", lambda: cut("fitted/splat.ply", 0.7), "fitted/splat.ply: is no readable .ply"),
    "splat missing": ("gaussians", Path("fitted/splat.ply").unlink, "fitted/splat.ply: does not exist"),
}


@pytest.mark.parametrize("case", SPOILT_RUNS)
def test_enhance_files(workplace: None, refused: Refused, case: str) -> None:
    form, spoil, message = SPOILT_RUNS[case]
    spoil()
    assert message in refused(*FORMS[form])


def test_enhance_run_of_another_step_or_place(workplace: None, refused: Refused) -> None:
    assert "fitted: has no renders of step 5; choose one of 2" in refused(*FORMS["run"], "step=5")
    assert "capture: holds no test/ours_<step>/renders" in refused(*enhance("run=capture"))
    assert "nowhere: is no folder" in refused(*enhance("run=nowhere"))
    both = ("references=fitted/train/ours_2/gt", "scene=capture", "scene.path=capture")
    assert "references: are given beside scene" in refused(*FORMS["renders"], *both)
    shutil.rmtree("fitted/test")  # as after a fit that holds no view out
    assert "or render its splat: gaussians=fitted/splat.ply scene=" in refused(*enhance("run=fitted"))


def test_enhance_splat_that_is_a_pipe(workplace: None, refused: Refused) -> None:
    os.mkfifo("pipe.ply")
    Path("fitted/splat.ply").unlink()
    os.symlink("../pipe.ply", "fitted/splat.ply")
    line = refused(*FORMS["gaussians"])
    assert "fitted/splat.ply: is no regular file" in line


@pytest.mark.parametrize("card", ["[1]", "[" * 100_000, '{"strength": "much"}'], ids=["list", "deep", "strength"])
def test_enhance_weights_with_a_card_that_is_none(workplace: None, refused: Refused, card: str) -> None:
    from safetensors import safe_open
    from safetensors.torch import load_file, save_file

    with safe_open("w.safetensors", "pt") as file:
        metadata = file.metadata()
    save_file(load_file("w.safetensors"), "w.safetensors", {**metadata, "card": card})
    line = refused(*FORMS["run"])
    assert "strength" in line if "much" in card else "w.safetensors: " in line


def test_enhance_splat_that_is_an_image(workplace: None, refused: Refused) -> None:
    save("fitted/splat.png")
    line = refused(*FORMS["gaussians"], "gaussians=fitted/splat.png")
    assert "fitted/splat.png: is no splat that can be read" in line


def test_enhance_splat_with_nan(workplace: None, refused: Refused) -> None:
    from gaussian_enhancer.splat.io.ply import read_ply, write_ply

    gaussians = read_ply("fitted/splat.ply")
    gaussians.means[7, 1] = math.nan
    write_ply("fitted/splat.ply", gaussians)
    line = refused(*FORMS["gaussians"])
    assert f"fitted/splat.ply: 1 of {len(gaussians)} Gaussians are not finite" in line
    assert "invalid=drop" in line
    cli.main([*FORMS["gaussians"], "invalid=drop", "output=out"])
    assert len(list(Path("out").iterdir())) == 2


@pytest.mark.parametrize("number", [0, 3])
def test_enhance_splat_whose_photos_are_cut_or_missing(workplace: None, refused: Refused, number: int) -> None:
    photo = Path(f"capture/images/{number}.png")
    cut(photo)
    assert f"{photo}: cannot be decoded" in refused(*FORMS["gaussians"])
    photo.unlink()
    assert f"{number}.png" in refused(*FORMS["gaussians"])


def test_enhance_splat_with_a_single_photo(workplace: None, refused: Refused) -> None:
    frames(lambda entries: entries[:1])(Path("capture"))
    assert "photo" in refused(*FORMS["gaussians"])


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("method=4dgs",), "method: is '4dgs'; choose auto, 3dgs, 2dgs, mip_splatting"),
        (("views=some",), "views: is 'some'"),
        (("scene.split.test_every=0",), "has no test view"),
        (("precision=int8",), "precision: is 'int8'"),
        (("tile=1",), "tile"),
        (("tile=abc",), "tile: is 'abc'; give a whole number"),
        (("strength=abc",), "strength: is 'abc'; give a number or null"),
        (("strength=nan",), "strength: is nan; give a finite number or null"),
        (("colour_clamping=nan",), "colour_clamping: is nan; give a whole number"),
        (("max_references=abc",), "max_references: is 'abc'; give a whole number or null"),
        (("weights=null",), "weights: is None; give text"),
        (("plan.share=abc",), "plan.share: is 'abc'; give a number"),
        *((("depth_scale=" + value,), "depth_scale: is") for value in ("0", "-1", "nan", "inf", "null")),
        (("max_references=-1",), "max_references: is -1; give a number of at least 0 or null"),
        (("max_references=9",), "max_references: is 9; give a number of at most 8 or null"),
        (("weights=none.safetensors",), "weights none.safetensors: is neither a file nor a shipped name"),
        (("weights=fitted/splat.ply",), "fitted/splat.ply: "),
        (("run=fitted",), "was given run and gaussians"),
        (("gaussians=null",), "was given nothing to enhance"),
        (("output=w.safetensors",), "cannot be written"),
        (("invalid=ignore",), "invalid: is 'ignore'"),
    ],
)
def test_enhance_options(workplace: None, refused: Refused, words: tuple[str, ...], message: str) -> None:
    assert message in refused(*FORMS["gaussians"], *words)


def test_enhance_splat_without_its_capture(workplace: None, refused: Refused) -> None:
    assert "gaussians: comes without its capture" in refused(*enhance("gaussians=fitted/splat.ply"))


def test_enhance_renders_without_references(workplace: None, refused: Refused) -> None:
    line = refused(*enhance("renders=fitted/test/ours_2/renders"))
    assert "comes without photos" in line
    shutil.copytree("fitted/test", "alone/test")
    line = refused(*enhance("renders=alone/test/ours_2/renders", "photos=alone/test/ours_2/gt"))
    assert "leaves no photo to refer to" in line
    assert "references=" in line
    assert "scene=capture scene.path=" in line


def test_enhance_renders_in_empty_or_missing_folders(workplace: None, refused: Refused) -> None:
    Path("empty").mkdir()
    assert "empty: holds no image" in refused(*FORMS["renders"], "renders=empty")
    assert "empty: holds no image" in refused(*FORMS["renders"], "photos=empty")
    assert "nowhere: is no folder" in refused(*FORMS["renders"], "renders=nowhere")


def test_enhance_renders_whose_parts_do_not_match(workplace: None, refused: Refused) -> None:
    save("photos/0.png", (WIDTH, HEIGHT + 2))
    save("photos/5.png")
    line = refused(*FORMS["renders"], "photos=photos")
    assert f"photos/0.png: is {WIDTH}x{HEIGHT + 2} but its render 0.png is {WIDTH}x{HEIGHT}" in line
    assert "has no depth for 0.png" in refused(*FORMS["renders"], "depth=fitted/train/ours_2/depth")
    assert "nowhere: is no folder" in refused(*FORMS["renders"], "depth=nowhere")
    assert "none.json" in refused(*FORMS["renders"], "cameras=none.json")
    Path("few.json").write_text(json.dumps(json.loads(Path("fitted/cameras.json").read_text())[1:]))
    assert "few.json: names no camera for 0.png" in refused(*FORMS["renders"], "cameras=few.json")
    stems = {path.stem for path in Path("fitted/test/ours_2/renders").iterdir()}
    entries = json.loads(Path("fitted/cameras.json").read_text())
    Path("few.json").write_text(json.dumps([entry for entry in entries if Path(entry["img_name"]).stem in stems]))
    assert "few.json: names no camera for any photo" in refused(*FORMS["renders"], "cameras=few.json")


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("output", [(), ("output=out",)])
def test_enhance_full_disk(
    workplace: None, form: str, output: tuple[str, ...], capsys: pytest.CaptureFixture[str]
) -> None:
    """Images that were written before the disk was full are whole; nothing says that the job is done."""
    before = contents()
    with full_disk(600), pytest.raises(SystemExit) as stop:
        cli.main([*FORMS[form], *output])
    lines = [line for line in capsys.readouterr().err.splitlines() if "gaussian-enhancer: " in line]
    assert (stop.value.code, len(lines)) == (2, 1), lines
    reason = "structure from motion: " if form == "renders" else "File too large"
    assert f"cannot be written ({reason}" in lines[0]
    for file in map(Path, contents().keys() - before.keys()):
        assert file.name in ("config.yaml", "failed") or file.suffix == ".png", file
        assert not file.name.startswith(".")
        if file.suffix == ".png":
            Image.open(file).load()


# train ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("word", "message"),
    [
        ("seed=-1", "seed: is -1; give a number of at least 0"),
        ("trainer.max_steps=-7", "trainer.max_steps: is -7; give a number of at least -1"),
    ],
)
def test_train_options(refused: Refused, word: str, message: str) -> None:
    assert message in refused("train", "logger=csv", "data.train=[nowhere]", "data.validation=[nowhere]", word)


def test_a_study_of_no_runs_writes_no_page(refused: Refused) -> None:
    line = refused("plan_study", "runs=nope", "results=results", "markdown=page.md")
    assert "runs: is nope, which holds no fit" in line


# measurements of fits ---------------------------------------------------------------------------------------------

OF_FITS = {
    "candidates": ("weights=[lr_tiny]",),
    "guards": ("guard=strength", "weights=[lr_tiny]"),
    "convergence": ("methods=[lr_tiny]",),
    "depth": (),
    "flicker": (),
    "already_good": (),
    "diversity": (),
    "fingerprints": (),
    "artefact_sheet": (),
    "sampler": (),
}


@pytest.mark.parametrize("job", OF_FITS)
def test_measurements_refuse_what_is_no_fit(job: str, refused: Refused) -> None:
    words = (job, *OF_FITS[job], "records=found.jsonl", "runtime.threads=1")
    assert "runs: name no fit; give folders of finished fits" in refused(*words)
    assert "nope-*: names no finished run; fit first" in refused(*words, "runs=[nope-*]")
    Path("bare").mkdir()
    assert "bare: names no finished run; fit first" in refused(*words, "runs=[bare]")
    Path("bare/done").write_text("{}")
    assert "bare: holds no renders of held-out views; name folders of finished fits" in refused(*words, "runs=[bare]")
    assert "records: is 'found.txt'; give a file that ends in .jsonl or .json" in refused(*words, "records=found.txt")


def test_realism_refuses_what_is_no_fit_and_rows_that_do_not_exist(refused: Refused) -> None:
    assert "test: is mandatory and was not given; add test=... train=..." in refused("realism")
    assert "nope: names no finished run" in refused("realism", "train=[nope]", "test=[nope]")
    assert "rows: names 'x'; choose from none, naive" in refused("realism", "train=[a]", "test=[b]", "rows=[x]")
    assert "add generator_weights=" in refused("realism", "train=[a]", "test=[b]", "rows=[tsds]")


def test_benchmarks_and_pictures_refuse_mistakes(refused: Refused) -> None:
    assert "sizes.0: is '24x'; give text that matches" in refused("splat_kernels", "sizes=[24x]")
    assert "methods: names 'x'; choose from stage 1" in refused("degradation", "methods=[x]")
    assert "rounds: is 0; give a number of at least 1" in refused("similarity", "rounds=0")
    assert "nope: holds no enhanced views" in refused("before_after", "run=nope", "output=picture.jpg")
    assert "name: is 'a/b'" in refused("ship", "weights=lr_tiny", "name=a/b", "helps=much", "harms=little")


def test_the_study_of_distilling_refuses_mistakes(refused: Refused) -> None:
    words = ("distil_study", "records=found.jsonl", "runtime.threads=1")
    assert "records: is mandatory and was not given; add records=..." in refused("distil_study", "runs=[plush/raw:a]")
    assert "records: is None" in refused("distil_study", "records=null")
    assert "found.jsonl: does not exist" in refused(*words)
    assert "plush=a: names no run; write CAPTURE/SPLAT:RUN" in refused(*words, "runs=['plush=a']")
    assert "nope: holds no renders of held-out views" in refused(*words, "runs=[plush/raw:nope]")
    Path("found.jsonl").write_text('{"view": "a"}\n')
    assert "lacks the column gaussians; measure again, with runs=" in refused(*words)
    assert "records: is 'found.txt'" in refused(*words, "records=found.txt")


def test_the_measurement_of_the_viewer_refuses_mistakes(refused: Refused, monkeypatch: pytest.MonkeyPatch) -> None:
    assert "run: is mandatory and was not given; add run=..." in refused("viewer_speed")
    assert "seconds: is 0" in refused("viewer_speed", "run=a", "seconds=0")
    assert "records: is 'a.txt'" in refused("viewer_speed", "run=a", "records=a.txt")
    with monkeypatch.context() as patched:  # to undo all of it would leave the test's folder, too
        patched.setattr("ablations.benchmarks.viewer_speed.refuse_without_browser", lambda: None)
        assert "the job view: does not start (nope: is no folder" in refused("viewer_speed", "run=nope")
    monkeypatch.setattr("ablations.benchmarks.viewer_speed.CHROMIUM", sys.executable)  # any file, where there is none
    monkeypatch.setattr("ablations.benchmarks.viewer_speed.DRIVER", "/nowhere")
    assert "/nowhere: does not exist; apt-get install" in refused("viewer_speed", "run=nope")


def test_the_measurement_of_videos_refuses_mistakes(refused: Refused) -> None:
    assert "run: is mandatory and was not given; add run=..." in refused("video_speed")
    assert "frames: is 1" in refused("video_speed", "run=a", "frames=1")
    assert "records: is 'a.txt'" in refused("video_speed", "run=a", "records=a.txt")
    assert "nope: is no folder" in refused("video_speed", "run=nope")
    assert "video nope=1: is refused" in refused("video_speed", "run=nope", "overrides=['nope=1']")


# simulate ---------------------------------------------------------------------------------------------------------


@pytest.fixture
def simulated() -> tuple[str, ...]:
    """A photo that ``simulate`` accepts, and its command."""
    save("photo.png", (12, 10))
    return ("simulate", "image=photo.png", "gate=none", "draws=1", "runtime.progress=false", "output=out")


def test_simulate_accepts_what_the_cases_below_spoil(simulated: tuple[str, ...]) -> None:
    cli.main(list(simulated))
    assert {p.name for p in Path("out").iterdir()} >= {"samples", "simulation.html", "simulation.json", "done"}


def test_simulate_truncated_empty_and_missing_photo(simulated: tuple[str, ...], refused: Refused) -> None:
    cut("photo.png")
    assert "photo.png: cannot be decoded" in refused(*simulated)
    Path("photo.png").write_bytes(b"")
    assert "photo.png: is empty (0 bytes)" in refused(*simulated)
    Path("photo.png").unlink()
    assert "photo.png: does not exist" in refused(*simulated)


def test_simulate_photo_without_a_white(simulated: tuple[str, ...], refused: Refused) -> None:
    Image.fromarray(np.zeros((4, 4), np.float32)).save("photo.tif")
    assert "photo.tif: has floating-point pixels" in refused(*simulated, "image=photo.tif")


def test_simulate_depth_that_does_not_fit(simulated: tuple[str, ...], refused: Refused) -> None:
    np.save("z.npy", np.ones((10, 13)))
    assert "z.npy: is 13x10 but photo.png is 12x10" in refused(*simulated, "depth=z.npy")
    np.save("z.npy", np.full((10, 12), -1.0))
    assert "z.npy: has depth -1" in refused(*simulated, "depth=z.npy")
    assert "none.npy: does not exist" in refused(*simulated, "depth=none.npy")


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("image=null",), "was given nothing to simulate from"),
        (("run=nowhere",), "was given image and run"),
        (("image=null", "run=nowhere"), "nowhere: is no folder"),
        (("view=a",), "view: was given beside image"),
        (("step=3",), "step: was given beside image"),
        (("image=null", "run=nowhere", "depth_scale=0.5"), "depth_scale: was given beside run"),
        (("seed=-1",), "seed: is -1"),
        (("draws=0",), "draws: is 0"),
        (("draws=many",), "draws: is 'many'"),
        (("depth_scale=0",), "depth_scale: is 0"),
        (("background=[0,0]",), "background: is [0, 0]"),
        (("background=white",), "background: is 'white'"),
        (("gate=random", "gate.types.needle=maybe"), "gate.types.needle: is 'maybe'"),
        (("gate=random", "gate.types.floater=maybe"), "gate.types.floater: is 'maybe'"),
        (("gate=random", "+gate.types.rain=false"), "gate.types.rain: is no type of artefact"),
        (("gate=adaptive",), "gate.file: is mandatory"),
        (("gate=adaptive", "gate.file=none.json"), "none.json: "),
        (("runtime.device=tpu",), "runtime.device: is 'tpu'"),
    ],
)
def test_simulate_options(simulated: tuple[str, ...], refused: Refused, words: tuple[str, ...], message: str) -> None:
    assert message in refused(*simulated, *words)


def test_simulate_full_disk(simulated: tuple[str, ...], capsys: pytest.CaptureFixture[str]) -> None:
    with full_disk(600), pytest.raises(SystemExit) as stop:
        cli.main(list(simulated))
    lines = [line for line in capsys.readouterr().err.splitlines() if "gaussian-enhancer: " in line]
    assert (stop.value.code, len(lines)) == (2, 1), lines
    assert "cannot be written (File too large)" in lines[0]
    assert not Path("out/done").exists()
    assert not [path for path in map(Path, contents()) if path.name.startswith(".")]
