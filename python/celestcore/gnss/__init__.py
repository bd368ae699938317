"""Attitude and orbit from GPS."""
