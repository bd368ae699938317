"""Campaigns: a grid of scenarios times trials, or a folder of logs, on one machine or many.

`run` simulates, filters and scores every trial of every cell of a grid, or replays every log of a
folder, and writes one row a run to a folder of Parquet files. It goes on where an earlier call, or
a smaller campaign, ended. ``celestcore campaign CONFIG.toml`` is the same on the command line.

====================  ==========================================================================
table                 keys
====================  ==========================================================================
``[campaign]``        title, tries, smooth, portable; of trials also trials, seed, first, batch,
                      skip_s, start (first_fix, drawn)
``[scenario]``        profile (earth_pointing, slews, constant_rate), duration_s, step_s;
                      semi_major_axis_m, inclination_deg, raan_deg, argument_of_latitude_deg;
                      angle_deg, slew_time_s, hold_time_s, axes, q0; rate_deg_per_s, q0
``[gyro]``            what `simulate.GyroErrors` takes: arw, rrw, bias, bias_sigma, markov_sigma,
                      markov_time_s, scale, misalignment, quantisation, mounting
``[star]``,           what `simulate.StarErrors` takes: sigma or sigma_arcsec, covariance,
``[star_NAME]``       period_s and offset_s, or every and offset_samples; mounting
``[assumed.gyro]``,   what the filter believes, where it differs: keys as in `Settings`
``[assumed.star]``
``[filter]``,         as in `Settings`
``[gate]``,
``[start]``
``[grid]``            lists of values for dotted settings: ``"star.sigma_arcsec" = [2, 5, 10]``
``[logs]``            instead of ``[scenario]``: folder, pattern; then all other tables are those
                      of `Settings` and win over those of the logs
====================  ==========================================================================

Examples
--------
>>> import tempfile
>>> import celestcore as cc
>>> config = {
...     "campaign": {"trials": 3},
...     "scenario": {"duration_s": 20.0},
...     "gyro": {"arw": 1e-6},
...     "star": {"sigma_arcsec": 5.0},
...     "grid": {"filter.kind": ["ekf", "ukf"]},
... }
>>> with tempfile.TemporaryDirectory() as folder:
...     cells = cc.campaign.run(config, folder).cells()
>>> [(cell["filter.kind"], cell["runs"]) for cell in cells]
[('ekf', 3), ('ukf', 3)]
"""

from __future__ import annotations

from celestcore.campaign._config import Campaign, Cell
from celestcore.campaign._results import Results, read
from celestcore.campaign._run import run

__all__ = ["Campaign", "Cell", "Results", "read", "run"]
