"""Photos at 4 times the resolution of a run's renders."""

from pathlib import Path

import pytest
import yaml

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.runs.high_resolution import HighResolutionPhotos
from gaussian_enhancer.scene.renders import read_run
from support.synthetic_runs import write_plane_run


def run_with(folder: Path, **configuration: object) -> Path:
    """A run whose configuration holds these values."""
    write_plane_run(folder)
    (folder / "config.yaml").write_text(yaml.safe_dump(configuration))
    return folder


def test_a_distilled_run_has_the_scene_of_its_fit(tmp_path):
    scene = {"_target_": "gaussian_enhancer.scene.procedural.procedural_scene", "family": "object", "seed": 1}
    fit = run_with(tmp_path / "fit", scene={**scene, "height": 48, "width": 64})
    distilled = run_with(tmp_path / "distilled", run=str(fit))
    again = run_with(tmp_path / "again", run=str(distilled))
    for run in (fit, distilled, again):
        rendered = HighResolutionPhotos(tmp_path / "fine")(run, read_run(run))
        assert all(view.read_fine_photo is not None for view in rendered.targets)
    other = run_with(tmp_path / "other", run=str(tmp_path / "other"))
    with pytest.raises(InputError, match="names no scene"):
        HighResolutionPhotos(tmp_path / "fine")(other, read_run(other))
