"""Frames, lines, replies: bytes from the host in, bytes to the host out."""
