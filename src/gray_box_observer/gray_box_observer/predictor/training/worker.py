"""The training process: jobs on standard input, results on output; ends with its parent."""

from __future__ import annotations

import os
import signal
import sys
import time

from gray_box_observer.predictor.training import worker_messages
from gray_box_observer.predictor.training.trainer_choice import make_trainer


def main() -> int:
    """Serve jobs until standard input closes."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent decides when to stop
    _give_way()
    source = sys.stdin.buffer
    sink = os.fdopen(os.dup(1), 'wb')
    os.dup2(2, 1)  # whatever a library prints must not reach the stream of results
    configuration = worker_messages.read(source)
    if configuration is None:
        return 0
    trainer = make_trainer(configuration)
    while (job := worker_messages.read(source)) is not None:
        start_s = time.process_time()
        result = trainer.train(job)
        try:
            worker_messages.write(sink, {**result, 'cpu_s': time.process_time() - start_s})
        except BrokenPipeError:
            break
    return 0


def _give_way() -> None:
    """Give sampling precedence: lowest priority, never the real-time one of the parent."""
    if hasattr(os, 'SCHED_BATCH'):
        os.sched_setscheduler(0, os.SCHED_BATCH, os.sched_param(0))
    os.nice(10)


if __name__ == '__main__':
    raise SystemExit(main())
