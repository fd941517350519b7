"""The loop allocates nothing. Meaningful on MicroPython, where the heap can be locked; there an
allocation raises MemoryError at its line. (CPython has no heap_lock: test_integers.py looks at
what only CPython can see.)"""

from rig import Rig

SESSION = (
    b"*IDN?;VE?;XS?;PH?\n",
    b"XF?;XH?\n",
    b"1>1TP?;1PA?;1PR?;1MD?;1MV?;1DH?;1VA?;TE?;TB?\n",
    b"1XP?;1XD?;1XV?;1XI?;1XL?;1XM?;1XT?;XK?;1XE?;1ZH?\n",
    b"1XP1000;1XD100;1VA50.25;1VA?\n",
    b"1XL3;1XL4;1ZH1;1ZH0;1XL0\n",
    b"XK500;1PR3;2PR-2\n",
    b"1PR1;1PA5;AT;9PR1;PR1;1PR;3PR1;1XP1;TB?;TB?;TB?;TB?;TB?;TB?;TB?;TB?\n",
    b"1ST;2ST\n",
    b"1PA1234567890;1SR100000000.000000;1VA2000;1VA?;SN?;1SN0;1ZH3\n",
    b"2>1PR2;1TP?;TB?\n",
    b"1DH-3.5;1PA-2;2MV-\n",
    b"0255-100",
    b"0100-100\n-2000200",
    b"!\n",
    b"00000000",
    b"1XQ25;1XY1;1XY?;1XQ?\n",
    b"0100-100\n-2000200",
    b"!\n1XQ0;1XY0;1XQ5\n",
    b"255-\n",
    b"0255\n",
    b"0255!tail\n",
    b"TE?;" * 33 + b"\n",
    b"1MV+;2MV-\n",
)


def test_the_loop_allocates_nothing():
    rig = Rig()
    rig.port.locked = True
    for data in SESSION:
        rig.send(data)
        rig.settle()
        rig.run(300_000)
    rig.send(b"XK200;1MV+\n02")
    rig.settle()
    rig.run(1_000_000)  # a frame left unfinished, a keep-alive that runs out
    assert rig.drives() == (0, 0)


def test_a_host_that_never_reads_makes_the_loop_allocate_nothing():
    rig = Rig()
    rig.port.locked = True
    rig.port.reading = False
    for _ in range(100):
        rig.send(b"02550255*IDN?\n")
        rig.settle()
    assert rig.drives() == (255, 255)
