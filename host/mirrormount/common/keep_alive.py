"""How long silence may last: of the host to its board, and of a client to the host. Imports nothing."""

KEEP_ALIVE_MS = 500  # without a byte for so long, the board ends its motions by itself
PATIENCE_S = 0.35  # silence of a client of a supervised mount after which its motion is stopped, unless told otherwise
LEAST_PATIENCE_S, MOST_PATIENCE_S = 0.1, 2.0  # that a person may choose: --patience
