"""Location of the configuration files."""

from pathlib import Path

from gaussian_enhancer.errors import InputError


def configurations() -> Path:
    """Find the folder of configurations: inside the installed package, or beside ``src`` in a checkout."""
    package = Path(__file__).resolve().parent
    for folder in (package / "conf", package.parents[1] / "conf"):
        if (folder / "base.yaml").is_file():
            return folder
    raise InputError(package / "conf", "is missing from the installation", "install the package again")
