"""Bytes to and from a board: lines over a serial port or TCP, finding ports, drives of CircuitPython boards."""
