"""The client library: a session with a board, its axes, status, settings, calibration."""
