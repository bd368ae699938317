"""Works on weights: three ways to resample."""

from __future__ import annotations

from celestcore import _core
from celestcore._check import FloatArray
from celestcore.bench import _inputs, _outcome
from celestcore.bench._work import Entry, Target, Timed, Work

PEERS = "celestcore.bench.peers"
COUNT = 100_000
AGREE = {
    "systematic": _outcome.systematic,
    "multinomial": _outcome.multinomial,
    "residual": _outcome.residual,
}


def _work(way: str) -> Work:
    def run(weights: FloatArray) -> Timed:
        ns, chosen = _core._bench_resample(way, weights, 3, 10)
        return Timed(ns, {"chosen": chosen})

    names = {"numpy": "numpy_resampling", "filterpy": "filterpy_resampling"}
    names |= {"particles": "particles_resampling", "numba": "numba_resampling"}
    return Work(
        name=way,
        title=f"{way} resampling of 1e5",
        item="particle",
        size=COUNT,
        quick=COUNT // 10,
        make=_inputs.weights,
        run=run,
        agree=AGREE[way],
        task=f"d_{way}",
        target=Target(1.3) if way == "systematic" else None,
        kernel=way,
        peers={peer: Entry(f"{PEERS}.{module}:{way}", COUNT) for peer, module in names.items()},
    )


def works() -> list[Work]:
    """Return the works on resampling."""
    return [_work(way) for way in AGREE]
