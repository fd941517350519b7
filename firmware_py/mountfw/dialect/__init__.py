"""The commands and queries of the command set."""
