"""A Dask cluster by its address."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from celestcore._optional import require
from celestcore.errors import CelestcoreError, InputError

TIMEOUT = "10s"
EVERY = 2.0  # s between two questions
PATIENCE = 60.0
"""Time without a single worker [s] after which a campaign gives up."""


@contextmanager
def cluster(address: str) -> Iterator[tuple[Any, Callable[[], None]]]:
    """Give an executor of a cluster, and a function that raises when the cluster is lost."""
    distributed = require("distributed", extra="dask", what="a Dask cluster")
    try:
        client = distributed.Client(address, timeout=TIMEOUT, set_as_default=False)
    except (OSError, ValueError) as error:
        raise InputError(
            f"no scheduler answers there ({error})", field="dask", value=address
        ) from None
    try:
        yield client.get_executor(pure=False), Watch(client, address)
    finally:
        client.close(timeout=2)


class Watch:
    """Raises when the scheduler is gone, or no worker has been there for a while."""

    def __init__(self, client: Any, address: str) -> None:
        self._client, self._address = client, address
        self._seen = self._asked = time.monotonic()

    def __call__(self) -> None:
        now = time.monotonic()
        if now - self._asked < EVERY:
            return
        self._asked = now
        if self._client.status == "closed":
            raise CelestcoreError(f"the scheduler at {self._address} is gone{KEPT}")
        if self._client.scheduler_info().get("workers"):
            self._seen = now
        elif now - self._seen > PATIENCE:
            raise CelestcoreError(
                f"no worker has been at {self._address} for {PATIENCE:.0f} s{KEPT}"
            )


KEPT = "; finished runs are kept, and the same call goes on"
