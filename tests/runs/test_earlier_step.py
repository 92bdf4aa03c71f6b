"""An earlier step of a run is chosen, enhanced as well and combined; what is for one step leaves it out."""

import shutil

import pytest
from PIL import Image

from gaussian_enhancer import enhance_folder
from gaussian_enhancer.align.alignment import Unwarped
from gaussian_enhancer.align.references import ReferenceConfig
from gaussian_enhancer.cli.enhance import run
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.infer.weights import save_weights
from gaussian_enhancer.runs.earlier_step import choose_earlier_step, resolve_earlier_step, splats_by_step
from gaussian_enhancer.runs.enhancement import naming_configuration
from gaussian_enhancer.scene.photos import read_photo
from gaussian_enhancer.scene.renders import read_run
from gaussian_enhancer.scene.scene import Photo, Scene
from gaussian_enhancer.splat.io.ply import write_ply
from support.bright_weights import bright_network
from support.job_config import job_config
from support.synthetic_runs import coloured_sheet, write_plane_run

STEPS = 1500, 4000, 9000, 16000


@pytest.fixture(scope="module")
def long_run(tmp_path_factory):
    """A run with renders of four steps, the last of which shows a floater; not to be written into."""
    folder = write_plane_run(tmp_path_factory.mktemp("runs") / "plane-long", steps=STEPS)
    for path in (folder / "test/ours_16000/renders").iterdir():
        render = Image.open(path).convert("RGB")
        render.paste((90, 90, 90), (24, 12, 40, 30))
        render.save(path)
    return folder


def configured(*overrides: str):
    return job_config("enhance", *overrides, "runtime.progress=false", "runtime.threads=1")


@pytest.mark.parametrize(
    ("earlier", "step", "chosen"),
    [
        ("auto", None, 4000),
        ("auto", 9000, 4000),
        ("auto", 4000, None),
        (1500, None, 1500),
        (9000, None, 9000),
        (None, None, None),
    ],
)
def test_the_step_nearest_to_a_fifth_is_chosen(long_run, earlier, step, chosen) -> None:
    assert choose_earlier_step(earlier, long_run, None, step, {}) == chosen


def test_a_run_without_old_renders_uses_none(plane_run) -> None:
    assert choose_earlier_step("auto", plane_run, None, None, {}) is None


def test_renders_of_training_views_are_not_needed(tmp_path) -> None:
    folder = write_plane_run(tmp_path / "plane", steps=(4000, 9000))
    (folder / "train/ours_4000").rename(tmp_path / "elsewhere")
    assert choose_earlier_step("auto", folder, None, None, {}) == 4000
    assert run(configured(f"run={folder}", f"output={tmp_path / 'out'}")) > 0


def test_a_step_without_a_held_out_view_is_refused(tmp_path) -> None:
    folder = write_plane_run(tmp_path / "plane", steps=(4000, 9000))
    (folder / "test/ours_4000/renders/view_004.png").unlink()
    with pytest.raises(InputError, match=r"earlier_step: has no render of view_004.png"):
        run(configured(f"run={folder}", f"output={tmp_path / 'out'}"))
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("earlier", [16000, 9000, 1000])
def test_a_step_that_is_not_an_earlier_one_is_refused(long_run, earlier) -> None:
    with pytest.raises(
        InputError, match=rf"earlier_step: is {earlier}; choose a step before the enhanced one, .*\(1500, 4000\)"
    ):
        choose_earlier_step(earlier, long_run, None, 9000, {})


def test_a_step_of_a_folder_of_renders_is_refused(tmp_path) -> None:
    assert choose_earlier_step("auto", None, None, None, {}) is None
    with pytest.raises(InputError, match=r"earlier_step: is 1500; .* \(there is none\)"):
        enhance_folder(renders=tmp_path, photos=tmp_path, earlier_step=1500, output=tmp_path / "out", device="cpu")


def test_a_result_folder_of_3dgs_has_earlier_splats(sheet_run, tmp_path) -> None:
    folder = tmp_path / "result"
    for name in ("iteration_7000", "iteration_30000", "iteration_x"):
        (folder / "point_cloud" / name).mkdir(parents=True)
        shutil.copy(sheet_run / "splat.ply", folder / "point_cloud" / name / "point_cloud.ply")
    assert sorted(splats_by_step(folder)) == [7000, 30000]
    assert choose_earlier_step("auto", None, folder, None, {}) == 7000
    assert choose_earlier_step("auto", None, folder / "point_cloud/iteration_7000/point_cloud.ply", None, {}) is None
    resolved = resolve_earlier_step(configured(f"gaussians={folder}"))
    assert resolved.earlier_step == 7000
    shutil.rmtree(folder / "point_cloud/iteration_7000")
    assert resolve_earlier_step(configured(f"gaussians={folder}")).earlier_step is None


def test_the_splats_of_a_result_folder_are_combined(plane_run, tmp_path) -> None:
    photos = tuple(
        Photo(view.name, view.camera, view.read_photo)
        for view in (*read_run(plane_run).targets, *read_run(plane_run).references)
    )
    capture = Scene("capture", photos, tuple(range(2, len(photos))), (0, 1))
    for iteration, side in ((7000, 24), (30000, 12)):
        folder = tmp_path / f"result/point_cloud/iteration_{iteration}"
        folder.mkdir(parents=True)
        write_ply(folder / "point_cloud.ply", coloured_sheet(side))
    images = {}
    for step in ("auto", 7000, None):
        options = {"gaussians": tmp_path / "result", "scene": capture, "earlier_step": step, "device": "cpu"}
        images[step] = [path.read_bytes() for path in enhance_folder(output=tmp_path / f"{step}", **options)]
    assert len(images["auto"]) == 2
    assert images["auto"] == images[7000]
    assert all(both != alone for both, alone in zip(images["auto"], images[None], strict=True))


@pytest.mark.parametrize(
    "option",
    [
        "second=other",
        "distil=true",
        "budget_ms=100",
        "max_references=0",
    ],
)
def test_options_that_are_for_one_step_leave_it_out(long_run, option) -> None:
    assert resolve_earlier_step(configured(f"run={long_run}", option)).earlier_step is None
    with pytest.raises(InputError, match=f"earlier_step: comes with {option.partition('=')[0]}"):
        resolve_earlier_step(configured(f"run={long_run}", option, "earlier_step=1500"))


def test_weights_that_do_not_warp_references_leave_it_out(long_run, tmp_path) -> None:
    save_weights(tmp_path / "unwarped.safetensors", bright_network(), ReferenceConfig(Unwarped()), {})
    option = f"weights={tmp_path / 'unwarped.safetensors'}"
    assert resolve_earlier_step(configured(f"run={long_run}", option)).earlier_step is None
    with pytest.raises(InputError, match="earlier_step: comes with weights that do not warp references"):
        enhance_folder(run=long_run, weights=option[8:], earlier_step=1500, output=tmp_path / "out", device="cpu")


@pytest.mark.parametrize("option", ["runtime.processes=2", "temporal_smoothing=0.5", "weights=sr_tiny"])
def test_options_for_which_it_is_used_as_well(long_run, option) -> None:
    assert resolve_earlier_step(configured(f"run={long_run}", option)).earlier_step == 4000


def test_without_an_earlier_step_the_run_keeps_its_name(plane_run) -> None:
    resolved = resolve_earlier_step(configured(f"run={plane_run}"))
    assert "earlier_step" not in naming_configuration(resolved)


def test_the_job_combines_both_steps(long_run, tmp_path, capsys) -> None:
    for name, *options in (("last", "earlier_step=null"), ("both",)):
        assert run(configured(f"run={long_run}", *options, f"output={tmp_path / name}")) > 0
    assert capsys.readouterr().err.count("The renders of step 4000 are used as well") == 1
    for path in sorted((tmp_path / "both").iterdir()):
        photo = read_photo(long_run / "test/ours_16000/gt" / path.name)
        last, both = (
            (read_photo(tmp_path / name / path.name) - photo)[:, 12:30, 24:40].square().mean()
            for name in ("last", "both")
        )
        assert float(both) < float(last) / 2  # the floater
    files = enhance_folder(run=long_run, output=tmp_path / "python", device="cpu")
    assert [file.read_bytes() for file in files] == [(tmp_path / "both" / file.name).read_bytes() for file in files]
    alone = enhance_folder(run=long_run, earlier_step=None, output=tmp_path / "alone", device="cpu")
    assert [file.read_bytes() for file in alone] == [(tmp_path / "last" / file.name).read_bytes() for file in alone]


def test_a_run_with_an_earlier_step_is_another_run(long_run, tmp_path) -> None:
    for option in ("earlier_step=auto", "earlier_step=4000", "earlier_step=null"):
        run(configured(f"run={long_run}", "every=2", option, f"runs={tmp_path}"))
    assert len(list((tmp_path / "enhance").iterdir())) == 2
