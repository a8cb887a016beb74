"""Recordings as episodes: streams on a reference clock, read lazily from MCAP and LeRobot datasets."""
