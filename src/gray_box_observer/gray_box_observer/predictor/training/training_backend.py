"""Where training runs: inline, or in a process of its own, out of the way of sampling."""

from __future__ import annotations

import itertools
import queue
import subprocess
import sys
import threading
import time
from contextlib import suppress
from typing import Any, Protocol

from gray_box_observer.errors import GrayBoxError
from gray_box_observer.predictor.training import worker_messages
from gray_box_observer.predictor.training.trainer_choice import make_trainer
from gray_box_observer.predictor.training.worker_messages import BEGIN, END, TRAIN


class Training(Protocol):
    """Takes one job at a time and gives its result back later."""

    share: float
    """Share of a core that it may use."""

    def submit(self, job: dict[str, Any]) -> None:
        """Start a job."""

    def collect(self) -> dict[str, Any] | None:
        """Return the finished job's result, or None while it still runs."""

    @property
    def busy(self) -> bool:
        """Whether a job runs whose result has not been collected."""

    @property
    def is_resting(self) -> bool:
        """Whether the training's share of a core is used up, so that no job should be submitted."""

    @property
    def failure(self) -> str | None:
        """Why training has ended for good, if it has."""

    def close(self) -> None:
        """Stop training for good."""


class InlineTraining:
    """Trains while the caller waits: for the offline command, where there is nothing else to do."""

    is_resting = False

    def __init__(self, configuration: dict[str, Any]) -> None:
        try:
            self._trainer = make_trainer(configuration)
        except ImportError as error:
            raise GrayBoxError(TORCH_MISSING) from error
        self._result: dict[str, Any] | None = None
        self.failure: str | None = None
        self.share = 1.0  # the caller waits: nothing else wants the core

    @property
    def busy(self) -> bool:
        """Whether a result waits to be collected."""
        return self._result is not None

    def submit(self, job: dict[str, Any]) -> None:
        """Run a job to its end."""
        if self.failure is not None:
            return
        try:
            self._result = self._trainer.train(job)
        except ImportError:
            self.failure = TORCH_MISSING

    def collect(self) -> dict[str, Any] | None:
        """Return the result."""
        result, self._result = self._result, None
        return result

    def close(self) -> None:
        """Nothing runs behind the caller's back."""


class ProcessTraining:
    """Trains in a child process, so that neither torch's import nor its work delays a sample.

    Args:
        configuration: of the trainer.
        process: the child, which may train for others too; None: one of its own.
    """

    def __init__(
        self, configuration: dict[str, Any], process: TrainingProcess | None = None
    ) -> None:
        self._process = process or TrainingProcess()
        self._results: queue.SimpleQueue[dict[str, Any]] = queue.SimpleQueue()
        self._busy = False
        self.share = float(configuration['rules']['core_share'])
        self._rest_until_s = 0.0
        self.failure: str | None = None
        self._process.begin(self, configuration)

    @property
    def busy(self) -> bool:
        """Whether a job runs whose result has not been collected."""
        return self._busy

    def submit(self, job: dict[str, Any]) -> None:
        """Hand a job over without waiting; its arrays are copied, for the buffer moves on."""
        if self.failure is None:
            self._busy = True
            copied_job = {k: v.copy() if hasattr(v, 'copy') else v for k, v in job.items()}
            self._process.submit(self, copied_job)

    def collect(self) -> dict[str, Any] | None:
        """Return the result if it is there; never waits."""
        try:
            result = self._results.get_nowait()
        except queue.Empty:
            return None
        self._busy = False
        self._rest_until_s = time.monotonic() + result.pop('cpu_s') * (1.0 / self.share - 1.0)
        return result

    @property
    def is_resting(self) -> bool:
        """Whether the child still has to make up for the time that its last job took."""
        return time.monotonic() < self._rest_until_s

    def close(self) -> None:
        """End for good, and the child with the last who trains in it; returns at once."""
        self._process.end(self)

    def receive(self, message: dict[str, Any]) -> None:
        """Take what the child says: a result, or why there will be none."""
        if 'failure' in message:
            self.fail(message['failure'])
        else:
            self._results.put(message)

    def fail(self, reason: str) -> None:
        """Note why training has ended for good."""
        is_torch = 'torch' in reason and 'No module' in reason
        self.failure = TORCH_MISSING if is_torch else f'training ended: {reason}'


class TrainingProcess:
    """A child process that trains for one or many; it runs as long as somebody trains in it.

    torch takes some hundred megabytes, once for all of them. Whose trainer fails is told so; the
    others go on.
    """

    def __init__(self) -> None:
        self._child: _Child | None = None
        self._numbers = itertools.count()

    def begin(self, training: ProcessTraining, configuration: dict[str, Any]) -> None:
        """Make the trainer of somebody; the first one starts the child."""
        if self._child is None or self._child.has_ended:
            self._child = _Child()
        self._child.begin(next(self._numbers), training, configuration)

    def submit(self, training: ProcessTraining, job: dict[str, Any]) -> None:
        """Hand a job over."""
        if self._child is not None:
            self._child.submit(training, job)

    def end(self, training: ProcessTraining) -> None:
        """Forget somebody's trainer; the last one ends the child."""
        child = self._child
        if child is None or not child.end(training):
            return
        self._child = None
        child.close()


class _Child:
    """The process itself, and three threads that write to it and read from it."""

    def __init__(self) -> None:
        command = [sys.executable, '-m', 'gray_box_observer.predictor.training.worker']
        self._process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE
        )
        self._messages: queue.SimpleQueue[dict[str, Any] | None] = queue.SimpleQueue()
        self._trainings: dict[int, ProcessTraining] = {}
        self._complaints: list[str] = []
        self._is_read_out = False
        threading.Thread(target=self._write, daemon=True, name='training jobs').start()
        self._listener = threading.Thread(
            target=self._listen, daemon=True, name='training messages'
        )
        self._listener.start()
        threading.Thread(target=self._read, daemon=True, name='training results').start()

    @property
    def has_ended(self) -> bool:
        """Whether it trains no more."""
        return self._is_read_out or self._process.poll() is not None

    def begin(self, number: int, training: ProcessTraining, configuration: dict[str, Any]) -> None:
        """Make a trainer; the number is its own."""
        self._trainings[number] = training
        self._messages.put({'trainer': number, 'task': BEGIN, **configuration})
        if self._is_read_out:  # meanwhile: nobody else will say so
            training.fail(self._reason)

    def submit(self, training: ProcessTraining, job: dict[str, Any]) -> None:
        """Hand a job over."""
        number = self._number(training)
        if number is not None:
            self._messages.put({'trainer': number, 'task': TRAIN, **job})

    def end(self, training: ProcessTraining) -> bool:
        """Forget a trainer; tell whether none is left."""
        number = self._number(training)
        if number is None:
            return False
        del self._trainings[number]
        self._messages.put({'trainer': number, 'task': END})
        return not self._trainings

    def close(self) -> None:
        """End the child, which has nothing to save; returns at once.

        It ends at its low priority, which takes long on a busy machine: the thread that reads its
        results waits for it.
        """
        self._messages.put(None)
        self._process.kill()

    def _number(self, training: ProcessTraining) -> int | None:
        return next((n for n, one in self._trainings.items() if one is training), None)

    def _write(self) -> None:
        assert self._process.stdin is not None
        while (message := self._messages.get()) is not None:
            try:
                worker_messages.write(self._process.stdin, message)  # type: ignore[arg-type]
            except (BrokenPipeError, OSError, ValueError):
                return

    def _read(self) -> None:
        source: Any = self._process.stdout
        while (message := worker_messages.read(source)) is not None:
            training = self._trainings.get(message.pop('trainer'))
            if training is not None:  # else it was closed meanwhile
                training.receive(message)
        self._listener.join(timeout=1.0)
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(timeout=1.0)
        self._is_read_out = True
        self._messages.put(None)
        for training in [*self._trainings.values()]:
            training.fail(self._reason)

    @property
    def _reason(self) -> str:
        """Why it has ended."""
        return self._complaints[-1] if self._complaints else f'exit status {self._process.poll()}'

    def _listen(self) -> None:
        assert self._process.stderr is not None
        for line in self._process.stderr:
            self._complaints = [*self._complaints[-20:], line.decode(errors='replace').rstrip()]


TORCH_MISSING = (
    'training of the predictor needs torch, which this Python does not have: install it with "pip '
    'install torch", '
    'or go on without: variant physics predicts untrained, predictor:=false or identify '
    '--skip-predictor not at all'
)
