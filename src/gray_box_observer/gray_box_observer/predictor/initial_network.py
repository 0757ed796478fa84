"""The first network of variant ``physics``: pre-trained on many motors, in the package.

Made by ``python -m gray_box_observer.predictor.training.pretrain``; reading it needs no torch.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from safetensors import SafetensorError
from safetensors.numpy import load_file, save_file

from gray_box_observer.errors import GrayBoxError
from gray_box_observer.predictor.network import Weights
from gray_box_observer.predictor.predictor_settings import TrainingSettings
from gray_box_observer.predictor.steady_state import INPUTS

SHIPPED = Path(__file__).with_name('start.safetensors')


def fresh(hidden: int, seed: int) -> Weights:
    """Return a network that answers 0, which leaves the slopes at both ends of the way."""
    weights = Weights.initial(INPUTS, hidden, seed)
    return replace(weights, output=np.zeros(hidden), output_bias=np.zeros(1))


def first_network(rules: TrainingSettings, seed: int) -> Weights:
    """Return the network to begin with; a fresh one where the shipped one's size differs."""
    if rules.start == 'shipped':
        shipped_network = load(SHIPPED)
        if shipped_network.hidden == rules.hidden:
            return shipped_network
    return fresh(rules.hidden, seed)


def load(path: Path) -> Weights:
    """Read a network.

    Raises:
        GrayBoxError: no such file, or not a network of this variant.
    """
    try:
        arrays = {name: array.astype(float) for name, array in load_file(path).items()}
        weights = Weights(**arrays)
    except OSError as error:
        raise GrayBoxError(f'cannot read the network {path}: {error.strerror or error}') from error
    except (SafetensorError, TypeError) as error:
        raise GrayBoxError(f'{path} is not a network of the predictor: {error}') from error
    if weights.input.shape[1:] != (INPUTS,):
        raise GrayBoxError(
            f'{path} holds a network of {weights.input.shape[-1]} inputs, expected {INPUTS}'
        )
    return weights


def save(weights: Weights, path: Path, made_by: str) -> None:
    """Write a network in single precision, with a word on how it was made.

    Raises:
        GrayBoxError: the file cannot be written.
    """
    arrays = {
        name: np.ascontiguousarray(array, dtype=np.float32)
        for name, array in weights.arrays().items()
    }
    try:
        save_file(arrays, path, metadata={'made by': made_by})
    except (OSError, SafetensorError) as error:
        raise GrayBoxError(f'cannot write {path}: {error}') from error
