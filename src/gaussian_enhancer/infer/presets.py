"""The settings that ``enhance budget_ms=`` chooses from, on disk, and the choice among them."""

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.files import write_text
from gaussian_enhancer.metrics.tradeoff import Point, best_within, mean_squared


@dataclass(frozen=True)
class Preset:
    """A setting of the job enhance with what it was measured to cost and to reach.

    Args:
        name: "curve/setting".
        weights: shipped name.
        enhance: overrides of the job enhance.
        milliseconds: a megapixel of output, median.
        psnr: mean over validation views, dB.
        machine: that it was measured on.
        commit: of the code that it was measured with.
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
        """Mean squared error over time."""
        return Point(self.name, self.milliseconds, mean_squared(self.psnr))


def write_presets(path: Path, presets: Sequence[Preset]) -> None:
    """Write what `read_presets` reads.

    Raises:
        InputError: the file cannot be written.
    """
    write_text(path, json.dumps([asdict(one) for one in presets], indent=1, ensure_ascii=False) + "\n")


def read_presets(path: Path) -> tuple[Preset, ...]:
    """The settings that a budget can choose from, at least one, the fastest first.

    Raises:
        InputError: the file is missing, or holds something else.
    """
    remedy = f"measure them: gaussian-enhancer tradeoff kind=quality settings={path}"
    try:
        values = json.loads(path.read_text(encoding="utf-8"))
        presets = [Preset(**{**one, "enhance": tuple(one["enhance"])}) for one in values]
        if not presets or not all(one.milliseconds > 0 for one in presets):
            raise ValueError("no setting, or one without a time")
    except FileNotFoundError:
        raise InputError("budget_ms", f"has no settings to choose from ({path} does not exist)", remedy) from None
    except (OSError, ValueError, TypeError, KeyError) as error:
        raise InputError(path, f"holds no settings ({error})", remedy) from None
    return tuple(sorted(presets, key=lambda one: one.milliseconds))


def choose(presets: Sequence[Preset], budget: float, megapixels: float, speed: float) -> tuple[Preset, str]:
    """The best setting within a budget, and what was chosen and why in words.

    Args:
        presets: at least one, the fastest first.
        budget: milliseconds an image.
        megapixels: of the image.
        speed: times of this machine over recorded ones; above 1 where this one is slower.

    Raises:
        InputError: nothing keeps within the budget.
    """
    best = best_within((one.point for one in presets), budget / (megapixels * speed))
    chosen = presets[0] if best is None else next(one for one in presets if one.name == best.name)
    expected = chosen.milliseconds * megapixels * speed
    if best is None:
        received = f"is {budget:g}, and the fastest setting, {chosen.name}, takes {expected:.0f} ms for this size here"
        raise InputError("budget_ms", received, f"give {expected * 1.1:.0f} or more, or enhance smaller images")
    words = " ".join((f"weights={chosen.weights}", *chosen.enhance))
    told = f"budget_ms={budget:g}: {chosen.name} ({words}), {expected:.0f} ms an image expected: "
    told += f"{chosen.milliseconds:.0f} ms/MP as recorded x {megapixels:.3f} MP x {speed:.2f}, the times of this "
    return chosen, told + f"machine over those of {chosen.machine}"
