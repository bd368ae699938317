"""Hands tasks to an executor, and goes on when a worker dies.

A pool of processes that loses one is broken as a whole, and does not say whose fault it was. So
those of its tasks that may have run then go again one at a time. A task that is alone when a worker
dies is cut into its runs, and a run that is alone then is counted a try; the others have cost
nothing but time.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import BrokenExecutor, CancelledError
from queue import Empty, SimpleQueue
from typing import Any, TypeAlias

from celestcore._campaign import Executor, Stopped
from celestcore.campaign._work import Columns, Task, perform
from celestcore.errors import CelestcoreError, InputError

IN_FLIGHT = 1024
"""Tasks that wait in an executor at most."""
POLL = 0.1  # s between two looks at what is not told
DEATHS = ("KilledWorker",)
"""Names of other libraries' errors that mean: a worker died, several times."""

Source: TypeAlias = "Executor | Callable[[], Executor]"
Deliver: TypeAlias = Callable[[Task, "Columns | str"], object]
"""Takes a task's columns, or the reason why it is given up."""


class Engine:
    """Runs tasks until all are delivered."""

    def __init__(
        self, source: Source, tries: int, watches: Sequence[Callable[[], None]] = ()
    ) -> None:
        submit = getattr(source, "submit", None)
        self._renewable = isinstance(source, type) or not callable(submit)
        if self._renewable and not callable(source):
            raise InputError("needs submit(fn, *args), as in concurrent.futures", field="executor")
        self._source: Any = source
        self._executor: Any = None if self._renewable else source
        self._tries, self._watches = tries, watches
        self._fresh: deque[Task] = deque()
        self._suspects: deque[Task] = deque()
        self._waiting: dict[int, tuple[Any, Task]] = {}
        self._ended: SimpleQueue[int] = SimpleQueue()
        self._sent = 0
        self._delivered = 0
        self._alone = False  # one task is out, and nothing goes out beside it
        self._broken = ""
        self._suspected: set[int] = set()

    def run(self, tasks: Iterable[Task], deliver: Deliver) -> None:
        """Run tasks and deliver each, in whatever order they end.

        Raises
        ------
        CelestcoreError
            If the executor has broken down and cannot be made again, or a worker cannot run tasks.
        """
        self._fresh.extend(tasks)
        try:
            while self._fresh or self._suspects or self._waiting:
                self._fill()
                number = self._next()
                if number is not None:
                    self._settle(number, deliver)
        except BaseException:
            self._stop(deliver)
            raise
        finally:
            self._close(wait=True)

    def _fill(self) -> None:
        if self._broken:
            if self._waiting:
                return  # they end with the same error
            if not self._renewable:
                raise CelestcoreError(
                    f"the executor has broken down ({self._broken}); finished runs are kept: call "
                    "again with a new one, or give a function that makes one"
                )
            self._close(wait=False)
            self._broken, self._suspected = "", set()
        if self._alone:
            return
        if self._suspects:
            if not self._waiting:
                self._send(self._suspects.popleft(), self._suspects)
                self._alone = bool(self._waiting)
            return
        while self._fresh and len(self._waiting) < IN_FLIGHT and not self._broken:
            self._send(self._fresh.popleft(), self._fresh)

    def _send(self, task: Task, back: deque[Task]) -> None:
        if self._executor is None:
            self._executor = self._source()
        try:
            future = self._executor.submit(perform, task)
        except BrokenExecutor as error:
            self._broken = _words(error)
            back.appendleft(task)
            return
        number, self._sent = self._sent, self._sent + 1
        self._waiting[number] = (future, task)
        heard = getattr(future, "add_done_callback", None)
        if callable(heard):
            heard(lambda _: self._ended.put(number))
        else:
            self._ended.put(number)  # it does not tell: its result is waited for

    def _next(self) -> int | None:
        """Return the number of a task that has ended, None if there is none for a while."""
        try:
            return self._ended.get(timeout=POLL)
        except Empty:
            for watch in self._watches:
                watch()
            return None

    def _settle(self, number: int, deliver: Deliver) -> None:
        future, task = self._waiting[number]
        alone, self._alone = self._alone, False
        try:
            columns: Columns = future.result()
        except CancelledError as error:
            raise CelestcoreError(
                f"the executor has given up its tasks ({_words(error)}); finished runs are kept"
            ) from error
        except (CelestcoreError, ImportError, Stopped):
            raise  # the next task would end the same way
        except BrokenExecutor as error:
            suspect = self._broke(number, error)
            del self._waiting[number]
            self._died(task, error, alone, suspect, deliver)
        except Exception as error:
            del self._waiting[number]
            if type(error).__name__ in DEATHS:
                self._died(task, error, alone, True, deliver)
            else:
                self._failed(task, error, deliver)
        else:
            del self._waiting[number]
            self._delivered += 1
            deliver(task, columns)

    def _broke(self, number: int, error: BrokenExecutor) -> bool:
        """Tell whether a task may have run when its pool broke: pools begin the oldest first."""
        self._broken = self._broken or _words(error)
        if not self._suspected:
            workers = getattr(self._executor, "_max_workers", IN_FLIGHT)
            self._suspected = set(sorted(self._waiting)[: 2 * workers + 1])
        return number in self._suspected or self._waiting[number][1].scares > 0

    def _died(
        self, task: Task, error: Exception, alone: bool, suspect: bool, deliver: Deliver
    ) -> None:
        if not alone:
            (self._suspects if suspect else self._fresh).append(task.scared())
        elif task.runs > 1:
            self._suspects.extendleft(reversed(task.one_by_one()))
        elif task.tries + 1 < self._tries:
            self._suspects.appendleft(task.again())
        else:
            deliver(task, f"its worker died, {_tried(task)}: {_words(error)}")

    def _failed(self, task: Task, error: Exception, deliver: Deliver) -> None:
        if task.runs > 1:
            self._fresh.extendleft(reversed(task.one_by_one()))
        elif task.tries + 1 < self._tries:
            self._fresh.appendleft(task.again())
        elif not self._delivered:
            raise CelestcoreError(f"no run has succeeded, {_tried(task)}: {_words(error)}")
        else:
            deliver(task, f"failed, {_tried(task)}: {_words(error)}")

    def _stop(self, deliver: Deliver) -> None:
        """Take what has ended meanwhile, and cancel the rest."""
        for future, task in self._waiting.values():
            task.stop.set()
            cancel = getattr(future, "cancel", None)
            if callable(cancel):
                cancel()
        for future, task in self._waiting.values():
            done = getattr(future, "done", None)
            if callable(done) and done() and not future.cancelled() and not future.exception():
                deliver(task, future.result())
        self._waiting.clear()

    def _close(self, *, wait: bool) -> None:
        """Shut down an executor that was made here."""
        shutdown = getattr(self._executor, "shutdown", None)
        if self._renewable and callable(shutdown):
            shutdown(wait=wait, cancel_futures=True)
        if self._renewable:
            self._executor = None


def _tried(task: Task) -> str:
    return f"tried {task.tries + 1} time{'s' if task.tries else ''}"


def _words(error: BaseException) -> str:
    return " ".join(f"{type(error).__name__}: {error}".rstrip(": ").split())
