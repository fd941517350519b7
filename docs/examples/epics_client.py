# Learn: a mount as an EPICS motor record. First, in another terminal: mirrormount ioc --virtual --prefix LAB:
import os
import sys

os.environ.setdefault("EPICS_CA_ADDR_LIST", "127.0.0.1")
os.environ.setdefault("EPICS_CA_AUTO_ADDR_LIST", "NO")
import epics  # it reads the environment now

prefix = sys.argv[1] if len(sys.argv) > 1 else "LAB:"  # real hardware: the prefix of its IOC
motor = epics.Motor(f"{prefix}m1:x")
for target in (3, -3, 0):
    motor.move(target, wait=True)
    certainty = epics.caget(f"{prefix}m1:x:certainty", as_string=True)
    print(f"asked for {target}: at {motor.get('RBV'):g} {motor.get('EGU')}, {certainty}")
epics.caput(f"{prefix}m1.STOP", 1)  # all motors of the board off, also those that other clients drive
