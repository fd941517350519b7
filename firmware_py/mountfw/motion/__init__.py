"""Axes, their bridges, end-stops, positions and homing, and the controller that runs them."""
