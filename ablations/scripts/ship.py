"""Puts trained weights into the package, with a card that says where they help and where not.

    python -m ablations.scripts.ship WEIGHTS NAME [--first NAME] --strength S --helps TEXT --harms TEXT

Writes `NAME.safetensors` and `NAME.json` to the package's folder of weights. What training wrote on the card (data,
steps, seed, hash of the configuration, validation) stays; the two texts summarise docs/results/quality.md.
With ``--first`` a cascade's first network is put back to weights that learnt from more than the cascade did.
"""

import argparse
import json
from typing import Any

from gaussian_enhancer.checkpoint import SHIPPED
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.files import whole_file
from gaussian_enhancer.infer.weights import Pretrained, design_of, load_weights, save_weights
from gaussian_enhancer.network.cascade import Cascade
from gaussian_enhancer.network.network import Network


def with_first(network: Network, first: Pretrained) -> tuple[Cascade, dict[str, Any]]:
    """A cascade with another first network, and what its card says of that.

    Raises:
        InputError: the network is no cascade.
    """
    if not isinstance(network, Cascade):
        raise InputError("weights", f"are of {type(network).__name__}", "give those of a cascade with --first")
    told = {name: first.card.get(name) for name in ("name", "run", "steps")}
    return Cascade(first.network, network.second, network.colour_clamping), told


def main() -> None:
    """Read the command line and write both files."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("weights")
    parser.add_argument("name")
    parser.add_argument("--first", help="weights of a cascade's first network, in place of what it became in training")
    parser.add_argument("--strength", type=float, default=1.0, help="share of the change to apply, from 0 to 1")
    parser.add_argument("--helps", required=True, help="where it helps")
    parser.add_argument("--harms", required=True, help="where it does not")
    options = parser.parse_args()
    found = load_weights(options.weights)
    network, card = found.network, {**found.card, "name": options.name, "strength": options.strength}
    card |= {"helps": options.helps, "harms": options.harms}
    if options.first:
        network, first = with_first(network, load_weights(options.first))
        card |= {"first": first, "design": design_of(network)}
    save_weights(SHIPPED / f"{options.name}.safetensors", network, found.reference_config, card)
    with whole_file(SHIPPED / f"{options.name}.json") as temporary:
        temporary.write_text(json.dumps(card, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
