"""Files that the job ``simulate`` writes: samples, contact sheets, a page, and a record of the random draws."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from omegaconf import DictConfig, OmegaConf

from gaussian_enhancer.degrade.artefacts.view import View
from gaussian_enhancer.degrade.gates.adaptive import AdaptiveGate
from gaussian_enhancer.degrade.gates.fingerprint import Fingerprint
from gaussian_enhancer.degrade.gates.gate import ArtefactStep, Gate
from gaussian_enhancer.degrade.photographed import SimulatorInput
from gaussian_enhancer.files import atomic_write, save_array, write_json
from gaussian_enhancer.report.simulation import EDGE, Section, sheet, write_page
from gaussian_enhancer.scene.image_files import write_image


@dataclass(frozen=True)
class SimulatedRender:
    """The record of one simulated render.

    Args:
        file: the image, relative to the job's folder.
        seed: seed of the sample's own random generator.
        steps: artefacts of stage 1, in the order in which they were applied.
    """

    file: str
    seed: int
    steps: tuple[ArtefactStep, ...]


def write_sample(path: Path, view: View) -> None:
    """Write image, depth and opacity of one sample to files in the same folder.

    Args:
        path: path of the image.
        view: pixels of the sample.

    Raises:
        InputError: a file cannot be written.
    """
    write_image(path, view.image[0])
    if view.depth is not None:
        save_array(path.with_name(f"{path.stem}_depth.npy"), view.depth[0, 0].float().cpu().numpy())
    if view.alpha is not None:
        write_image(path.with_name(f"{path.stem}_alpha.png"), view.alpha[0].expand(3, -1, -1))


def provenance(photo: SimulatorInput, cfg: DictConfig, fingerprint: Fingerprint | None, gate: Gate) -> dict[str, str]:
    """Provenance of the page's images.

    Args:
        photo: the photo.
        cfg: configuration of the job.
        fingerprint: fingerprint of the run's training views; None if they are not known.
        gate: the chosen gate.
    """
    entries = {**photo.origin, "Gate": OmegaConf.to_yaml(cfg.gate).strip()}
    if fingerprint is not None:
        entries["Fingerprint"] = fingerprint.table()
    if isinstance(gate, AdaptiveGate):
        entries["Calibrated"] = gate.table()
    return {**entries, "Generator": OmegaConf.to_yaml(cfg.generator).strip(), "Seed": str(cfg.seed)}


def write_sheets(
    folder: Path, photo: SimulatorInput, sections: Sequence[Section], provenance: Mapping[str, str]
) -> None:
    """Write the page and the sections' contact sheets.

    Args:
        folder: the job's folder.
        photo: the photo.
        sections: sections of the page.
        provenance: origin of the images.

    Raises:
        InputError: a file cannot be written.
    """
    for section in sections:
        if section.file and section.rows:
            with atomic_write(folder / f"{section.file}.png") as temporary:
                sheet(section).save(temporary)
    height, width = photo.view.image.shape[-2:]
    subtitle = f"{width} x {height} pixels · sheets are made from a copy of at most {EDGE} pixels"
    write_page(folder / "simulation.html", f"Simulated renders of {photo.name}", subtitle, sections, provenance)


def write_record(
    folder: Path, seed: int, samples: Sequence[SimulatedRender], fingerprint: Fingerprint | None, gate: Gate
) -> None:
    """Write what determines the samples; a calibrated gate and a fingerprint go to files that other jobs can read.

    Args:
        folder: the job's folder.
        seed: seed of the job.
        samples: records of the samples.
        fingerprint: fingerprint of the run's training views; None if they are not known.
        gate: the chosen gate.

    Raises:
        InputError: a file cannot be written.
    """
    record: dict[str, Any] = {"seed": seed, "samples": [asdict(sample) for sample in samples]}
    record["fingerprint"] = None if fingerprint is None else asdict(fingerprint)
    if fingerprint is not None:
        fingerprint.to_json(folder / "fingerprint.json")
    if isinstance(gate, AdaptiveGate):
        gate.to_file(folder / "gate.json")
    write_json(folder / "simulation.json", record, indent=1)
