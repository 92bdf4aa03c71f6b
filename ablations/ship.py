"""Puts trained weights into the package, with a card that says where they help and where not.

    python ablations/ship.py WEIGHTS NAME --strength S --helps TEXT --harms TEXT

Writes `NAME.safetensors` and `NAME.json` to the package's folder of weights. What training wrote on the card (data,
steps, seed, hash of the configuration, validation) stays; the two texts are a reader's summary of docs/quality.md.
"""

import argparse
import json

from gaussian_enhancer.checkpoint import SHIPPED
from gaussian_enhancer.enhance.weights import load_weights, save_weights
from gaussian_enhancer.files import whole_file


def main() -> None:
    """Read the command line and write both files."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("weights")
    parser.add_argument("name")
    parser.add_argument("--strength", type=float, default=1.0, help="share of the change to apply, from 0 to 1")
    parser.add_argument("--helps", required=True, help="where it helps")
    parser.add_argument("--harms", required=True, help="where it does not")
    options = parser.parse_args()
    found = load_weights(options.weights)
    card = {**found.card, "name": options.name, "strength": options.strength}
    card |= {"helps": options.helps, "harms": options.harms}
    save_weights(SHIPPED / f"{options.name}.safetensors", found.network, found.preparation, card)
    with whole_file(SHIPPED / f"{options.name}.json") as temporary:
        temporary.write_text(json.dumps(card, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
