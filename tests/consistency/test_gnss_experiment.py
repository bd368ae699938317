"""The GPS and star-sensor experiment as it is defined: 100 runs, every target."""

from __future__ import annotations

import pytest
from celestcore.reproduce import gnss_star


@pytest.mark.long
def test_every_target_holds_over_100_runs() -> None:
    result = gnss_star.run(seed=20190121)
    assert [(t.asked, t.found) for t in result.targets() if not t.met] == []
    assert result.to_dict()["failures"] == {}
    coloured = result.figures
    assert coloured["position_coloured_1m"].series.value == pytest.approx(1.56, rel=0.15)
    assert coloured["nees_coloured_1m"].series.value < 6.0
    assert coloured["nees_coloured_ignored_1m"].series.value > 30.0
