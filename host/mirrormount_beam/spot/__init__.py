"""Where the spot is in an image."""
