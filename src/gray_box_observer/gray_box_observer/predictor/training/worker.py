"""The training process: jobs on standard input, results on output; ends with its parent."""

from __future__ import annotations

import os
import signal
import sys
import time
from typing import Any

from gray_box_observer.predictor.training import worker_messages
from gray_box_observer.predictor.training.trainer import Trainer
from gray_box_observer.predictor.training.trainer_choice import make_trainer
from gray_box_observer.predictor.training.worker_messages import BEGIN, END


def main() -> int:
    """Serve jobs until standard input closes."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent decides when to stop
    _give_way()
    source = sys.stdin.buffer
    sink = os.fdopen(os.dup(1), 'wb')
    os.dup2(2, 1)  # whatever a library prints must not reach the stream of results
    trainers: dict[int, Trainer] = {}
    while (message := worker_messages.read(source)) is not None:
        answer = _answer(trainers, message)
        if answer is None:
            continue
        try:
            worker_messages.write(sink, answer)
        except BrokenPipeError:
            break
    return 0


def _answer(trainers: dict[int, Trainer], message: dict[str, Any]) -> dict[str, Any] | None:
    """Do what a message asks for; return what there is to say, None: nothing.

    Args:
        trainers: those that there are, by number; one that fails is no more.
        message: see :mod:`~gray_box_observer.predictor.training.worker_messages`.
    """
    number = message.pop('trainer')
    task = message.pop('task')
    try:
        if task == BEGIN:
            trainers[number] = make_trainer(message)
        elif task == END:
            trainers.pop(number, None)
        elif number in trainers:
            start_s = time.process_time()
            result = trainers[number].train(message)
            return {**result, 'cpu_s': time.process_time() - start_s, 'trainer': number}
    except Exception as error:
        trainers.pop(number, None)
        reason = ' '.join(f'{type(error).__name__}: {error}'.split())
        return {'failure': reason, 'trainer': number}
    return None


def _give_way() -> None:
    """Give sampling precedence: lowest priority, never the real-time one of the parent."""
    if hasattr(os, 'SCHED_BATCH'):
        os.sched_setscheduler(0, os.SCHED_BATCH, os.sched_param(0))
    os.nice(10)


if __name__ == '__main__':
    raise SystemExit(main())
