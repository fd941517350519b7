"""Errors, remedies, validation of values, files, progress, signals: imports nothing else of this package."""
