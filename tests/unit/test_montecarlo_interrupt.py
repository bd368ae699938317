"""Ctrl-C with an executor: in a process of its own, with a real signal."""

from __future__ import annotations

import math
import os
import signal
import subprocess
import sys
import threading
import time

import pytest

pytestmark = pytest.mark.skipif(os.name == "nt", reason="there is no SIGINT to send there")

SCRIPT = """
import sys, threading, time
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from multiprocessing import get_context
import celestcore as cc
from celestcore import simulate

class Threads(ThreadPoolExecutor):
    futures = []
    def submit(self, *args):
        self.futures.append(super().submit(*args))
        return self.futures[-1]

class Processes(ProcessPoolExecutor):
    futures = []
    def submit(self, *args):
        self.futures.append(super().submit(*args))
        return self.futures[-1]

def main(kind, chunk):
    star = simulate.StarErrors(1e-5, every=2)
    gyro = simulate.GyroErrors(1e-6)
    scenario = simulate.Scenario(simulate.earth_pointing(600.0), gyro, star)
    def told(done, total):
        if done == chunk or chunk > 1000:
            print("begun", flush=True)
    if kind == "threads":
        pool = Threads(2)
    else:
        pool = Processes(2, mp_context=get_context("spawn"))
    if chunk > 1000:  # nothing is ever done
        threading.Timer(1.0, lambda: print("begun", flush=True)).start()
    with pool:
        try:
            cc.monte_carlo(
                scenario, scenario.navigator(), 10**6, executor=pool, chunk=chunk, progress=told
            )
        except KeyboardInterrupt:
            print("raised", time.time(), flush=True)
            print("waits", sum(not f.done() for f in pool.futures), flush=True)
    print("left", time.time(), flush=True)

if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]))
"""


PATIENCE = 60.0
"""Seconds after which an attempt is given up and killed.

Python itself can lose a Ctrl-C: one that arrives just after a `threading.Condition` took its lock
leaves it locked, and the pool waits for ever. That is seldom, and not this package's to mend.
"""


def interrupted(kind: str, chunk: int, group: bool) -> tuple[float, float, int]:
    """Return how long the call and the pool took to end, and how many tasks were left."""
    command = [sys.executable, "-c", SCRIPT, kind, str(chunk)]
    run = subprocess.Popen(
        command,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
        start_new_session=True,
    )
    given_up = threading.Timer(PATIENCE, os.killpg, (run.pid, signal.SIGKILL))
    given_up.start()
    try:
        assert run.stdout is not None
        assert run.stdout.readline() == "begun\n"
        sent = time.time()
        if group:
            os.killpg(run.pid, signal.SIGINT)
        else:
            run.send_signal(signal.SIGINT)
        said = dict(line.split() for line in run.stdout.read().splitlines())
        if run.wait() == -signal.SIGKILL:
            return math.inf, math.inf, 0
    finally:
        given_up.cancel()
        run.kill()
        run.communicate()
    assert run.returncode == 0
    return float(said["raised"]) - sent, float(said["left"]) - sent, int(said["waits"])


def shortest(kind: str, chunk: int, *, group: bool = False) -> tuple[float, float, int]:
    """Return the quickest of three: a busy machine may let one attempt wait."""
    found = []
    for _ in range(3):
        found.append(interrupted(kind, chunk, group))
        if found[-1][1] < 0.5:
            break
    return min(found, key=lambda times: times[1])


@pytest.mark.parametrize("chunk", [20, 10**5])
def test_threads_stop_within_half_a_second(chunk: int) -> None:
    """Also in the midst of tasks that would take minutes."""
    raised, left, waiting = shortest("threads", chunk)
    print(raised, left, waiting)
    assert raised <= left < 0.5
    assert waiting <= 2


def test_a_process_pool_is_left_with_what_runs() -> None:
    """The signal goes to this process alone: its workers cannot hear of it."""
    raised, left, waiting = shortest("processes", 20)
    print(raised, left, waiting)
    assert raised < 0.5
    # two run, three more are already on their way to the workers
    assert waiting <= 5
    assert left < 5.0


def test_ctrl_c_in_a_terminal_stops_a_process_pool() -> None:
    """The signal goes to the workers too, in the midst of tasks that would take minutes."""
    raised, left, waiting = shortest("processes", 10**5, group=True)
    print(raised, left, waiting)
    assert raised < 0.5
    assert left < 2.0
    assert waiting <= 5
