"""The commands of `mirrormount`: main is their table, then one file a command."""
