"""One file a board: its pins, its bridge, and the constants that go with them."""
