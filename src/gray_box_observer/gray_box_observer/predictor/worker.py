"""The training process: reads jobs from standard input, writes results to standard output, ends with its parent."""

from __future__ import annotations

import os
import signal
import sys

from gray_box_observer.predictor import messages


def main() -> int:
    """Serve jobs until standard input closes."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent decides when to stop
    os.nice(10)  # sampling comes first
    source, sink = sys.stdin.buffer, os.fdopen(os.dup(1), 'wb')
    os.dup2(2, 1)  # whatever a library prints must not reach the stream of results
    configuration = messages.read(source)
    if configuration is None:
        return 0
    import torch

    from gray_box_observer.predictor.trainer import Trainer

    torch.set_num_threads(1)
    trainer = Trainer(configuration)
    while (job := messages.read(source)) is not None:
        try:
            messages.write(sink, trainer.train(job))
        except BrokenPipeError:
            break
    return 0


if __name__ == '__main__':
    raise SystemExit(main())
