"""Errors, remedies, validation of values, files, tokens, progress, signals: imports nothing else of this package."""
