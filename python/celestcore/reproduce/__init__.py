"""Published experiments, run again: one module and one command each.

- `star_gyro`: ``celestcore reproduce star-gyro``, Wang and Jiang (2020).
"""

from celestcore.reproduce import star_gyro

__all__ = ["star_gyro"]
