from pathlib import Path

import pytest

from support.bright_weights import write_bright_weights


@pytest.fixture(scope="session")
def bright(tmp_path_factory) -> Path:
    """Weights of a network that brightens what it sees."""
    return write_bright_weights(tmp_path_factory.mktemp("weights"), strength=1.0)
