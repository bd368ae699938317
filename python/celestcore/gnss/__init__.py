"""Position and attitude from GNSS and star sensors."""
