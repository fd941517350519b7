"""Encoders: counts, and the closed loop over them. Loaded only where a board file names one (build.py)."""
