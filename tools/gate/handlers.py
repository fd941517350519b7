"""The gate's two interrupt handlers, in Thumb assembler: the source of mountfw/ports/rp2_handlers.py.

They find their state at a fixed distance from their code, so they may lie anywhere. r4 is the state, whose offsets are
below. Section numbers are those of the RP2040 data sheet. docs/gate.md explains what they are for. After a change:

    mpy-cross -march=armv6m tools/gate/handlers.py     # tests/repo/test_gate_code.py finds the two in its output
"""

# ruff: noqa: F821
# pyright: reportUndefinedVariable=false, reportArgumentType=false, reportAttributeAccessIssue=false

import micropython
from micropython import const

_ALARM = const(0xD0)  # in the block of rp2_gate.py: the second handler,
_STATE = const(0x130)  # and the state
_RAW = const(0x28)  # of the timer, 4.6.5: TIMERAWL, INTR, ALARM0
_INTR = const(0x34)
_ALARM0 = const(0x10)
_BULK = const(0x2A)  # the upper six bits of an endpoint's control: enabled, one buffer with an interrupt, bulk, 4.1.2.5
_ENDPOINT_BIT = const(32)  # of endpoint 2, out, in BUFF_STATUS, 4.1.4

# offsets in the state
_ZEROS = const(0)  # that came last, in a row
_PACKETS = const(4)  # looked at, ever
_STOPS = const(8)  # found, ever
_CUT_AT = const(12)  # when the first one after a release was found, us of the timer
_HELD = const(16)  # 1 from then on until the release
_PACKET_AT = const(20)  # when the last packet was looked at
_NEXT = const(24)  # the USB stack's handler
_USB_CONTROL = const(28)  # addresses: the endpoint's control, its buffer control, BUFF_STATUS, DPRAM, the timer
_USB_BUFFER = const(32)
_USB_STATUS = const(36)
_USB_DPRAM = const(40)
_CLOCK = const(44)
_LATE = const(48)  # packets looked at only after the USB stack's handler
_NOTHING = const(52)  # a word that may be written to
_AXES = const(64)  # four axes, each: set aliases of two CTRL, deadline, _IDLE, _WAITING or _ENDED
_AXIS = const(16)
_IDLE = const(0)
_WAITING = const(1)
_ENDED = const(2)


@micropython.asm_thumb
def _tap():
    data(2, 0xA400 | (_STATE - 4) >> 2)  # adr r4: the state
    ldr(r0, [r4, _USB_BUFFER])
    ldr(r7, [r0, 0])  # r7: buffer control, before
    ldr(r0, [r4, _USB_STATUS])
    ldr(r0, [r0, 0])
    mov(r6, _ENDPOINT_BIT)
    and_(r6, r0)  # r6: has a packet landed?
    beq(CHAIN)
    bl(LOOK)
    label(CHAIN)
    ldr(r0, [r4, _NEXT])
    data(2, 0x4780)  # blx r0: the USB stack
    cmp(r6, 0)
    bne(END)
    ldr(r0, [r4, _USB_BUFFER])  # has one landed since, and the USB stack taken it unseen?
    ldr(r1, [r0, 0])
    ldr(r0, [r4, _USB_STATUS])
    ldr(r0, [r0, 0])
    lsl(r0, r0, 26)  # the endpoint's bit
    bmi(END)  # it still waits: it has an interrupt of its own
    eor(r7, r1)
    mov(r0, r7)
    and_(r0, r1)
    lsl(r0, r0, 16)  # FULL: new
    bmi(LATE)
    lsl(r0, r7, 18)  # the PID: another one
    bpl(END)
    lsl(r0, r1, 21)  # AVAILABLE: the buffer is the controller's again, so it was a full packet
    bpl(END)
    mov(r1, 64)
    label(LATE)
    mov(r7, r1)
    ldr(r0, [r4, _LATE])
    add(r0, 1)
    str(r0, [r4, _LATE])
    bl(LOOK)
    b(END)

    label(LOOK)  # at the packet, whose length is in the lower ten bits of r7
    push({r6, lr})
    ldr(r0, [r4, _USB_CONTROL])
    ldr(r3, [r0, 0])
    lsr(r0, r3, 26)
    cmp(r0, _BULK)
    bne(LOOKED)
    lsl(r3, r3, 16)
    lsr(r3, r3, 16)
    mov(r0, 63)
    bic(r3, r0)
    ldr(r0, [r4, _USB_DPRAM])
    add(r3, r3, r0)  # r3: the packet
    lsl(r2, r7, 22)
    lsr(r2, r2, 22)  # r2: bytes left
    ldr(r0, [r4, _CLOCK])
    ldr(r0, [r0, _RAW])
    str(r0, [r4, _PACKET_AT])
    ldr(r0, [r4, _PACKETS])
    add(r0, 1)
    str(r0, [r4, _PACKETS])
    ldr(r5, [r4, _ZEROS])  # r5: zeros in a row
    b(MORE)
    label(BYTE)
    ldrb(r6, [r3, 0])
    add(r3, 1)
    sub(r2, 1)
    cmp(r6, 0x30)
    bne(OTHER)
    add(r5, 1)
    cmp(r5, 8)
    beq(STOP)
    b(MORE)
    label(OTHER)
    mov(r5, 0)
    cmp(r6, 0x21)
    bne(MORE)
    label(STOP)
    mov(r5, 4)
    mov(r6, r4)
    mov(r0, 2)
    lsl(r0, r0, 8)  # _LOW
    label(FORCE)
    ldr(r1, [r6, _AXES])
    str(r0, [r1, 0])
    ldr(r1, [r6, _AXES + 4])
    str(r0, [r1, 0])
    add(r6, _AXIS)
    sub(r5, 1)
    bne(FORCE)
    ldr(r0, [r4, _STOPS])
    add(r0, 1)
    str(r0, [r4, _STOPS])
    ldr(r0, [r4, _HELD])
    cmp(r0, 0)
    bne(MORE)
    mov(r0, 1)
    str(r0, [r4, _HELD])
    ldr(r0, [r4, _CLOCK])
    ldr(r0, [r0, _RAW])
    str(r0, [r4, _CUT_AT])
    label(MORE)
    cmp(r2, 0)
    bne(BYTE)
    str(r5, [r4, _ZEROS])
    label(LOOKED)
    pop({r6, pc})
    label(END)


@micropython.asm_thumb
def _alarm():
    data(2, 0xA400 | (_STATE - _ALARM - 4) >> 2)  # adr r4: the state
    ldr(r5, [r4, _CLOCK])
    mov(r0, 1)
    str(r0, [r5, _INTR])  # seen
    label(AGAIN)
    mov(r6, 1)
    lsl(r6, r6, 30)  # r6: until the next deadline; at first more than any
    mov(r3, r4)
    add(r3, _AXES)
    mov(r7, 4)
    label(AXIS)
    ldr(r0, [r3, 12])
    cmp(r0, _WAITING)
    bne(NEXT)
    ldr(r0, [r3, 8])
    ldr(r1, [r5, _RAW])
    sub(r0, r0, r1)
    cmp(r0, 0)
    bgt(LATER)
    mov(r0, 2)
    lsl(r0, r0, 8)  # _LOW
    ldr(r1, [r3, 0])
    str(r0, [r1, 0])
    ldr(r1, [r3, 4])
    str(r0, [r1, 0])
    mov(r0, _ENDED)
    str(r0, [r3, 12])
    b(NEXT)
    label(LATER)
    cmp(r0, r6)
    bge(NEXT)
    mov(r6, r0)
    ldr(r2, [r3, 8])  # r2: the next deadline
    label(NEXT)
    add(r3, _AXIS)
    sub(r7, 1)
    bne(AXIS)
    lsr(r0, r6, 30)
    bne(END)  # none
    str(r2, [r5, _ALARM0])
    ldr(r0, [r5, _RAW])  # the timer fires at that very microsecond only: is it still to come?
    sub(r0, r2, r0)
    cmp(r0, 0)
    ble(AGAIN)
    label(END)
