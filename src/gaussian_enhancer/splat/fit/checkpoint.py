"""Checkpoint from which an interrupted fit continues: one file of plain tensors and numbers, replaced atomically."""

import pickle
from pathlib import Path
from typing import Any

import torch

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.files import atomic_write
from gaussian_enhancer.input_files import refuse_larger_archive

NAME = "checkpoint.pt"


def save_checkpoint(folder: Path, values: dict[str, Any]) -> None:
    """Replace the folder's checkpoint.

    Args:
        folder: the run's folder.
        values: the fit's state: tensors, numbers, strings and dictionaries of them.

    Raises:
        InputError: the file cannot be written; the earlier checkpoint is kept.
    """
    with atomic_write(folder / NAME) as temporary:
        try:
            torch.save(values, temporary)
        except RuntimeError as error:  # torch's zip writer reports a full disk as RuntimeError
            raise OSError(str(error).splitlines()[0]) from error


def load_checkpoint(folder: Path, identity: str) -> dict[str, Any] | None:
    """Load the folder's checkpoint onto the CPU, or return None if there is none.

    Args:
        folder: the run's folder.
        identity: description of the fit; must equal the checkpoint's.

    Raises:
        InputError: the file is damaged or belongs to another fit.
    """
    if not holds_checkpoint(folder):
        return None
    path = folder / NAME
    refuse_larger_archive(path)
    try:
        values: dict[str, Any] = torch.load(path, map_location="cpu", weights_only=True)
    except (RuntimeError, pickle.UnpicklingError, EOFError) as error:
        raise InputError(path, f"cannot be read ({type(error).__name__})", "delete it to start again") from error
    if values["identity"] != identity:
        raise InputError(path, "belongs to a fit with other settings", "choose another folder, or delete it")
    return values


def holds_checkpoint(folder: Path) -> bool:
    """Whether a folder holds the checkpoint of an interrupted fit."""
    return (folder / NAME).is_file()


def discard_checkpoint(folder: Path) -> None:
    """Remove the checkpoint of a finished fit.

    Args:
        folder: the run's folder.
    """
    (folder / NAME).unlink(missing_ok=True)
