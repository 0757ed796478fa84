"""Samples: messages paired by stamp; what is refused and why. Read `pairing.py` first."""

from gray_box_observer.samples.pairing import Pairing
from gray_box_observer.samples.raw_history import RawHistory
from gray_box_observer.samples.rejection import Rejection
from gray_box_observer.samples.replay_buffer import ReplayBuffer
from gray_box_observer.samples.sample import Sample, seconds

__all__ = ['Pairing', 'RawHistory', 'Rejection', 'ReplayBuffer', 'Sample', 'seconds']
