"""A shaft that nothing drives: a hand may turn it, and a sensor may fall silent. Imports codes, position, ticks."""

from mountfw import codes
from mountfw.encoder.position import NOISE
from mountfw.wire.ticks import diff as apart  # counts wrap as times do


class AtRest:
    """Of one EncodedAxis."""

    def __init__(self, axis):
        self._axis = axis
        self.still_at = 0  # counts of the motor
        self._recorded_at = 0  # the same, while they are on the flash
        self._seen = self._band = 0  # the same, at the last look, and how far it may be off
        self.gone = False  # was it told that the encoder does not answer?

    def look(self):
        """Look at the encoder, between two moves. Where it says what it said before, that is all."""
        axis, position = self._axis, self._axis.measured
        band = axis.dead_band
        if position.reader.play_us and band < NOISE:
            band = NOISE
        seen = position.same() and position.motor == self._seen and band == self._band
        if not (seen and not self.gone and (axis.drive.on_flash or self._recorded_at == self._seen)):
            self._look(band)

    def _look(self, band):
        axis, position = self._axis, self._axis.measured
        axis.check_stop()
        position.look()
        axis.check_stop()
        motor = self._seen = position.motor
        self._band = band
        if not axis.drive.on_flash:
            self._recorded_at = motor
        if not -band <= apart(motor, self.still_at) <= band:  # a query may have looked before
            self.still_at = motor
            axis.has_moved = True
        if axis.drive.on_flash and not -band <= apart(motor, self._recorded_at) <= band:
            axis.drive.drop_record()  # it would tell another number
        if position.reader.gone != self.gone:
            self.gone = position.reader.gone
            if self.gone:
                axis.error(codes.AXIS_ENCODER_LOST)
