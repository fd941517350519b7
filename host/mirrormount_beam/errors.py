"""The errors of cameras and of the beam that they see, in the form of mirrormount/errors.py."""

from mirrormount.errors import MountError


class CameraError(MountError):
    """A camera cannot be set, or a picture is of no form that is known.
    Remedy: What the line says.
    """


class CameraAbsent(CameraError):
    """There is no such camera, file or folder of pictures, another program has the camera, or this user may not
    open it.
    Remedy: `mirrormount camera list` lists cameras. Close other programs that show its picture. Linux:
    `sudo usermod -aG video $USER` and log in again.
    """


class CameraSettingRefused(CameraError):
    """The camera has not taken an exposure, a gain, a size or a form of the pictures: it cannot, it has the number in
    other steps, or its driver does not tell what it has.
    Remedy: Ask for what the line says that it has, or for a number near it. A size may need another --fourcc (MJPG);
    on Windows another --backend may help.
    """


class CameraGone(CameraError):
    """The camera was unplugged, or does not deliver frames any more. What was recorded before is kept.
    Remedy: Plug it in, into a port of its own without a hub, and start again.
    """


class CameraBlack(CameraError):
    """All pixels of the first frames have one and the same value: the lens is covered, the exposure is much too
    short or too long, or another program holds the camera.
    Remedy: Remove the cap, switch on the laser, or change the exposure (`mirrormount camera show` shows the picture).
    """


class CameraSlow(CameraError):
    """The camera delivers fewer frames in a second than asked for: a long exposure, a hub that is shared, a busy
    computer.
    Remedy: A shorter exposure and more light, a USB port of its own, a smaller picture, or ask for a lower rate.
    """


class CameraRepeats(CameraError):
    """The camera, or its driver, returned the same picture byte for byte again and again, so nothing is measured.
    Remedy: Unplug the camera and plug it in. A screen recorder or a virtual camera program does so when it hangs.
    """


class CameraSizeChanged(CameraError):
    """A frame has another size than the frames before, so positions in it are not comparable.
    Remedy: Close other programs that set the camera, and start again. A saved scale of another size is not used.
    """


class SpotLost(MountError):
    """The camera shows no spot that could be measured, for longer than a frame or two. The line has the reason.
    Remedy: What the line says; `mirrormount camera show` shows the threshold and the spot. Motors are off, and what was
    measured before is kept.
    """


class NotMeasurable(MountError):
    """The readings contradict what the experiment assumes, or the picture is too small for it.
    Remedy: What the line says.
    """


class CannotCompare(MountError):
    """The place of the spot that was kept with a position cannot be found again with this camera: it was kept without a
    spot, with another camera, or in a picture of another size.
    Remedy: What the line says; `mirrormount keep NAME --camera CAMERA` keeps the position of now with its spot.
    """


class ResponseOfOther(MountError):
    """The saved calibration of the table belongs to other boards, other cameras, another length of a step, or another
    size of the pictures: what it says of a pulse is not true here.
    Remedy: `mirrormount calibrate`, or put back what was changed.
    """


class NotControllable(MountError):
    """These cameras cannot tell what these mounts do: two mounts move the beam in four ways, and one camera sees two of
    them; or an axis does not move the spot at all.
    Remedy: What the line says: a second camera at another distance, one mount, or look at motor and coupler.
    """


class SignalError(MountError):
    """The source of a signal cannot be opened or read. Motors are off.
    Remedy: What the line says; `mirrormount align --help` names the sources.
    """


class SignalNotANumber(SignalError):
    """The source of the signal gave something that is no finite number: NaN, an overflow, or a word.
    Remedy: Look at what it shows: a meter out of its range says so in this way. Choose a range that holds the largest
    power, or correct --query or your function.
    """


class SignalSaturated(SignalError):
    """The signal is at the end of its range: it would stay there while the power rises, so no maximum can be found.
    Remedy: Less light or less gain: a filter, a smaller load resistor at the photodiode, a shorter exposure.
    """


class SignalDark(SignalError):
    """The signal is not above 0, or does not change, whichever axis is driven: there is no light in the fibre or on the
    detector, it is not the detector of this beam, no motor turns the mirrors, or a meter tells dBm.
    Remedy: Bring 1 % of the light into it by hand or by `mirrormount scan`; set the meter to watts and take its dark
    value off; look at the detector's cable and the motors.
    """
