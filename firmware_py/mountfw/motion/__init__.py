"""Axes, their bridges, end-stops and positions, and the controller that runs them."""
