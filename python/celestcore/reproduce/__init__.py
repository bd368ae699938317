"""Published experiments, run again: one module and one command each.

- `star_gyro`: ``celestcore reproduce star-gyro``, Wang and Jiang (2020).
- `celestial_orbit`: ``celestcore reproduce celestial-orbit``, Ning and Ma (2010).
- `gnss_star`: ``celestcore reproduce gnss-star``, Zhang, Chen and Wang (2019).
"""

from celestcore.reproduce import celestial_orbit, gnss_star, star_gyro

__all__ = ["celestial_orbit", "gnss_star", "star_gyro"]
