"""Encoders: counts, and the closed loop over them."""
