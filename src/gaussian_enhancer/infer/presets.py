"""Presets on disk, and the choice of the best one within a time budget (``enhance budget_ms=``)."""

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.files import write_text
from gaussian_enhancer.input_files import JSON_GROWTH, parse_json, read_text
from gaussian_enhancer.metrics.tradeoff import Point, best_within, mean_squared_error


@dataclass(frozen=True)
class Preset:
    """A setting of the job ``enhance`` with its measured time and quality.

    Args:
        name: "curve/setting".
        weights: name of shipped weights.
        enhance: overrides of the job ``enhance``.
        milliseconds: median time per megapixel of output.
        psnr: mean PSNR over validation views in dB.
        machine: the machine of the measurement.
        commit: commit of the measured code.
    """

    name: str
    weights: str
    enhance: tuple[str, ...]
    milliseconds: float
    psnr: float
    machine: str
    commit: str

    @property
    def point(self) -> Point:
        """Time and mean squared error."""
        return Point(self.name, self.milliseconds, mean_squared_error(self.psnr))


def write_presets(path: Path, presets: Sequence[Preset]) -> None:
    """Write presets as JSON.

    Raises:
        InputError: the file cannot be written.
    """
    write_text(path, json.dumps([asdict(preset) for preset in presets], indent=1, ensure_ascii=False) + "\n")


def read_presets(path: Path) -> tuple[Preset, ...]:
    """Read presets, the fastest first.

    Returns:
        At least one preset.

    Raises:
        InputError: the file is missing or malformed.
    """
    remedy = f"measure them: gaussian-enhancer tradeoff kind=quality settings={path}"
    try:
        values = parse_json(read_text(path, JSON_GROWTH), path)
        presets = [Preset(**{**preset, "enhance": tuple(preset["enhance"])}) for preset in values]
        if not presets or not all(preset.milliseconds > 0 for preset in presets):
            raise ValueError("no setting, or one without a time")
    except InputError as error:
        if error.received != "does not exist":
            raise InputError(path, f"holds no settings ({error.received})", remedy) from None
        raise InputError("budget_ms", f"has no settings to choose from ({path} does not exist)", remedy) from None
    except (OSError, ValueError, TypeError, KeyError) as error:
        raise InputError(path, f"holds no settings ({error})", remedy) from None
    return tuple(sorted(presets, key=lambda preset: preset.milliseconds))


def choose_preset(presets: Sequence[Preset], budget: float, megapixels: float, speed: float) -> tuple[Preset, str]:
    """Choose the preset with the best quality within a budget.

    Args:
        presets: at least one, the fastest first.
        budget: milliseconds per image.
        megapixels: size of the image.
        speed: time on this machine divided by the recorded time; above 1 where this machine is slower.

    Returns:
        The preset, and a sentence that says what was chosen and why.

    Raises:
        InputError: no preset keeps within the budget.
    """
    best = best_within((preset.point for preset in presets), budget / (megapixels * speed))
    chosen = presets[0] if best is None else next(preset for preset in presets if preset.name == best.name)
    expected = chosen.milliseconds * megapixels * speed
    if best is None:
        received = f"is {budget:g}, and the fastest setting, {chosen.name}, takes {expected:.0f} ms for this size here"
        raise InputError("budget_ms", received, f"give {expected * 1.1:.0f} or more, or enhance smaller images")
    settings = " ".join((f"weights={chosen.weights}", *chosen.enhance))
    line = f"budget_ms={budget:g}: {chosen.name} ({settings}), {expected:.0f} ms an image expected: "
    line += f"{chosen.milliseconds:.0f} ms/MP as recorded x {megapixels:.3f} MP x {speed:.2f}, the times of this "
    return chosen, line + f"machine over those of {chosen.machine}"
