"""Mounts as EPICS motor records, served by `mirrormount ioc`. Needs the extra [epics].

cli.py       `mirrormount ioc`: which mounts, who may write
fields.py    the table of fields: record types, documentation and screen are made of it
motor.py     what each field of a motor does; pure, without EPICS and without a mount
mount.py     a supervised mount and its axes as records
table.py     the cameras of a table and the loop that holds its beam; needs the extra [beam]
pump.py      the one thread that tells the records what has happened, and gives signs of life
autosave.py  what a person has set on a record, kept for the next start
screen.py    a screen for Phoebus
base.py      record types in Python on EPICS base, by ctypes

Channel Access, PVAccess, put-callbacks and access security are EPICS base's own (the wheel epicscorelibs).
"""
