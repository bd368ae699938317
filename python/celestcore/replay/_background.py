"""Jobs done in order by a thread of their own, so that the filter need not wait for the disk."""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable
from types import TracebackType

from celestcore._check import warn

Job = Callable[[], object]


class Background:
    """Does jobs one after the other, a few behind who gives them; use it in a ``with``.

    After a job that failed none is begun any more, so what they write has no holes. Its error is
    raised where the next job is given, or at the end.
    """

    def __init__(self, waiting: int) -> None:
        self._jobs: queue.Queue[Job | None] = queue.Queue(maxsize=waiting)
        self._error: BaseException | None = None
        self._stopped = threading.Event()
        self._thread = threading.Thread(target=self._run, name="celestcore-writer", daemon=True)

    def _run(self) -> None:
        while (job := self._jobs.get()) is not None:
            if self._stopped.is_set():
                continue  # taken nevertheless: who gives them must not wait for ever
            try:
                job()
            except BaseException as error:  # handed to the thread that gives jobs
                self._error = error
                self._stopped.set()

    def do(self, job: Job) -> None:
        """Give a job; waits while too many are waiting.

        Raises
        ------
        BaseException
            What a job before it raised.
        """
        self._raise()
        self._jobs.put(job)

    def _raise(self) -> None:
        if self._error is not None:
            error, self._error = self._error, None
            raise error

    def __enter__(self) -> Background:
        self._thread.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        # after an error of the caller, too, what was given is done: it is complete and may be kept
        try:
            self._jobs.put(None)
            self._thread.join()
        except BaseException:  # Ctrl-C while waiting: no more than the job under way
            self._stopped.set()
            raise
        if error is None:
            self._raise()
        elif self._error is not None:
            warn(f"what was left to be written could not be: {self._error}")
