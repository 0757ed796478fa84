"""Where large groups are computed: numpy and compiled code, or torch on a device."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager

from gray_box_observer.errors import ConfigurationError, brief

CPU = 'cpu'
"""No device of its own: numpy and compiled code; networks are taught by torch on the processor."""

DEVICE_FROM = 8192
"""Motors at once from which on a device is taken to be worth its while; a guess, for nobody has
measured one yet. However few they are, a block of samples or a prediction is hundreds of calls,
thousands where motors differ."""

NAME = re.compile(r'cpu|cuda(:(0|[1-9]\d{0,3}))?')
"""Names of devices: ``cpu``, ``cuda`` (the one that is current), ``cuda:1`` (the second one)."""


def check_name(name: str) -> None:
    """Refuse what names no device; whether there is one is another question.

    Raises:
        ConfigurationError: neither ``cpu`` nor ``cuda`` nor ``cuda:N``.
    """
    if not NAME.fullmatch(name):
        raise ConfigurationError(
            f'parameter device must be cpu, cuda or cuda:N (such as cuda:0), got {brief(name)}'
        )


def torch_device(name: str) -> str | None:
    """Return torch's device for large groups; None for ``cpu``, which needs no torch.

    Raises:
        ConfigurationError: the name is none, torch is missing, it sees no such device, or that does
            not compute.
    """
    check_name(name)
    if name == CPU:
        return None
    try:
        import torch
    except (ImportError, OSError) as error:  # OSError: a library is missing that it was built for
        raise ConfigurationError(
            f'parameter device is {name}, which needs torch, and this Python cannot import it: '
            f'{_reason(error)}: '
            'install it with "pip install torch", or set device to cpu'
        ) from error
    count = torch.cuda.device_count() if torch.cuda.is_available() else 0
    if count == 0:
        build_note = (
            ''
            if torch.version.cuda or torch.version.hip
            else f' (torch {torch.__version__} is built without CUDA)'
        )
        raise ConfigurationError(
            f'parameter device is {name}, but torch sees no GPU{build_note}: install a driver and '
            'a '
            'torch built for it, or '
            'set device to cpu'
        )
    number = int(name.partition(':')[2] or 0)
    if number >= count:
        raise ConfigurationError(
            f'parameter device is {name}, but torch sees {count} of them, cuda:0 to '
            f'cuda:{count - 1}: name one of '
            'these, or set device to cpu'
        )
    try:
        _try_out(name)
    except RuntimeError as error:
        raise ConfigurationError(
            f'parameter device is {name}, but it does not compute: {_reason(error)}: install a '
            'torch built for it, '
            'or set device to cpu'
        ) from error
    return name


@contextmanager
def watched(device: str) -> Iterator[None]:
    """Report failures of a device in one line: out of memory, lost GPU. Also a decorator.

    Raises:
        ConfigurationError: instead of torch's `RuntimeError`.
    """
    try:
        yield
    except RuntimeError as error:
        raise ConfigurationError(
            f'device {device} failed: {_reason(error)}: set device to cpu, or let it have fewer '
            'motors'
        ) from error


def _try_out(device: str) -> None:
    """Compute something in double precision as blocks do: a visible GPU may lack kernels."""
    import torch

    square = torch.eye(2, dtype=torch.float64, device=device)
    torch.linalg.solve_ex(square, square)[0].cpu()


def _reason(error: Exception) -> str:
    """The first line of what torch says; the others are advice on how to debug it."""
    lines = str(error).strip().splitlines()
    return lines[0].strip().rstrip('.') if lines else type(error).__name__
