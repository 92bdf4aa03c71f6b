import pytest

from gaussian_enhancer.report.compared import ComparedView
from support.report_samples import NASTY, compared


@pytest.fixture(scope="session")
def views() -> list[ComparedView]:
    return [
        compared("001.png", 0.5, 1),
        compared(NASTY, -0.25, 2),
        compared("003.png", 0.001, 3, height=64, width=36),
    ]


@pytest.fixture(scope="session")
def provenance() -> dict[str, str]:
    return {"Commit": "0123abc", "Configuration": "runs/<x>/config.yaml", "Machine": "2 cores", "Weights": "sif & co"}
