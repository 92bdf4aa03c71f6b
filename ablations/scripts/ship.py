"""``gaussian-enhancer ship``: copy trained weights into the package, with a card that states where they help.

Writes `NAME.safetensors` and `NAME.json` to the package's folder of weights. The card keeps the entries of the training
(data, steps, seed, hash of the configuration, validation); its two texts summarise docs/results/test.md.
``first`` replaces a cascade's first network by weights that were trained on more data than the cascade; their
confidence and their way to align references come with them.
``references`` and ``candidates`` replace the numbers of references and candidates that the training used.
"""

from dataclasses import replace
from typing import Any

from omegaconf import DictConfig

from gaussian_enhancer.checkpoint import SHIPPED_FOLDER
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.files import write_json
from gaussian_enhancer.infer.weights import Pretrained, design_of, load_weights, reference_config_of, save_weights
from gaussian_enhancer.network.cascade import Cascade
from gaussian_enhancer.network.network import Network
from gaussian_enhancer.runs.instantiate import plain_values, require


def with_first(network: Network, first: Pretrained) -> tuple[Cascade, dict[str, Any]]:
    """A cascade with another first network, and the entry on it for the card.

    Raises:
        InputError: the network is no cascade.
    """
    if not isinstance(network, Cascade):
        raise InputError("weights", f"are of {type(network).__name__}", "give those of a cascade with first=")
    first_card = {name: first.card.get(name) for name in ("name", "run", "steps", "data")}
    return Cascade(first.network, network.second, network.colour_clamping), first_card


def run(cfg: DictConfig) -> None:
    """Write both files.

    Args:
        cfg: conf/ship.yaml, composed.

    Raises:
        InputError: weights cannot be used, or a file cannot be written.
    """
    require(cfg)
    pretrained = load_weights(cfg.weights)
    network, card = pretrained.network, {**pretrained.card, "name": cfg.name, "strength": cfg.strength}
    card |= {"helps": cfg.helps, "harms": cfg.harms}
    reference_config, confidence = pretrained.reference_config, pretrained.confidence
    if cfg.first:
        first = load_weights(cfg.first)
        network, first_card = with_first(network, first)
        # The confidence was trained on the change of that network, with references aligned as for it.
        reference_config, confidence = replace(first.reference_config, fine=True), first.confidence
        credited = dict.fromkeys(credit for one in (card, first.card) for credit in one.get("credits", ()))
        card |= {"first": first_card, "design": design_of(network), "credits": list(credited)}
    card |= plain_values(cfg.card)
    counts = {name: cfg[name] for name in ("references", "candidates") if cfg[name] is not None}
    reference_config = replace(reference_config, **counts)
    card |= {"reference_config": reference_config_of(reference_config)}
    save_weights(SHIPPED_FOLDER / f"{cfg.name}.safetensors", network, reference_config, card, confidence)
    write_json(SHIPPED_FOLDER / f"{cfg.name}.json", card, indent=2)
