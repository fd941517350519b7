"""The form of the names that a user gives to mounts and cameras of a table (device/table_file.py). Imports nothing."""

import re

TABLE_VARIABLE = "MIRRORMOUNT_TABLE"  # of the environment: the file of names, instead of table.toml
NAME_RULE = "a letter, then letters, digits, - and _, at most 31 in all, and no COM port"
_NAME = re.compile(r"(?!com[0-9]+$)[a-z][a-z0-9_-]{0,30}", re.IGNORECASE)


def is_name(text: str) -> bool:
    """True for a text that may be a name, and so is no port and no address."""
    return bool(_NAME.fullmatch(text))
