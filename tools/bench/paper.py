"""What the mount's first controller does: the figures that ours stand beside, as text.

Measured on the paper's sketch (M. Gopalakrishnan and M. Guehr, A low-cost mirror mount control system for optics
setups, Appendix A), as SOURCE says.
"""

SOURCE = (
    "the paper's sketch (Appendix A) compiled unchanged, on an emulated ATmega328P at 16 MHz, simavr 1.6,"
    " true 9600-baud bytes"
)

FRAME = "34.6 / 84.8 ms"  # last byte to enable of motor 1 / motor 2: medians of 60; at most 35.6 / 85.8
STOP = "34.3 / 84.4 ms"  # last byte of `00000000` to enable 1 / 2 low, nothing else going on: medians of 60
STOP_LATE = "34 ms to never"  # lost in 20 cases of 20 within 32 ms after another frame; then 135 ms, falling to 34
STOP_LOST = "lost"
PULSE_ERROR = "sd 0.84 to 1.9 ms"  # 0.2 s timed by its host: without jitter of the host, and with 5 ms of it
SHORTEST = "142.85 ms"
FRAMES_PER_S = "6.99"  # one in 143 ms: 100 of 100 obeyed
LONGEST_PASS = "143 ms"  # from a frame to being ready for the next: median of 20
NONE = "none"  # it knows no end-stops
NEVER_STOPS = "runs for ever"  # watched for 300 s
