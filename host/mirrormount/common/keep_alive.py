"""The keep-alive that the host sets on a board, a fact of host and documents. Imports nothing."""

KEEP_ALIVE_MS = 500  # without a byte for so long, the board ends its motions by itself
