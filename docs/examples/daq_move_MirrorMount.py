"""A mirror mount as a plug-in of PyMoDAQ 5, to be put into daq_move_plugins of a package of plug-ins.

One move at a time ends as the board says; PyMoDAQ's polling keeps it alive.
"""

from pymodaq.control_modules.move_utility_classes import DAQ_Move_base, DataActuatorType, comon_parameters_fun, main
from pymodaq.utils.data import DataActuator

from mirrormount import Mount
from mirrormount.errors import MountError


class DAQ_Move_MirrorMount(DAQ_Move_base):
    """An axis of a mount, in steps. The other one is a slave: it shares the port."""

    _controller_units = ""  # steps
    is_multiaxes = True
    _axis_names = ["x", "y"]  # noqa: RUF012
    _epsilon = 0.6  # a move ends at the nearest whole step
    data_actuator_type = DataActuatorType.DataActuator
    params = [  # noqa: RUF012
        {"title": "Port (empty: the one board):", "name": "port", "type": "str", "value": ""},
        *comon_parameters_fun(axis_names=_axis_names, epsilon=_epsilon),
    ]

    def ini_attributes(self) -> None:
        """No mount yet."""
        self.controller: Mount | None = None

    def ini_stage(self, controller: Mount | None = None) -> tuple[str, bool]:
        """Open the mount, or take the master's."""
        self.controller = Mount.open(self.settings["port"] or None) if self.is_master else controller
        return self.controller.identity, True

    def get_actuator_value(self) -> DataActuator:
        """The position."""
        position = DataActuator(data=self._axis.position, units=self.controller_units)
        return self.get_position_with_scaling(position)

    def user_condition_to_reach_target(self) -> bool:
        """A move is over when the board says so."""
        return not self._axis.status().moving

    def move_abs(self, position: DataActuator) -> None:
        """Begin to go there."""
        self.target_value = position = self.check_bound(position)
        self._axis.move_to(round(self.set_position_with_scaling(position).value()), wait=False)

    def move_rel(self, position: DataActuator) -> None:
        """Begin to go so far."""
        self.move_abs(self.current_value + position)

    def move_home(self) -> None:
        """To position 0: finding a home is for `mirrormount home`."""
        self.move_abs(DataActuator(data=0, units=self.controller_units))

    def stop_motion(self) -> None:
        """All motors off, now."""
        self.controller.stop()
        self.move_done()

    def commit_settings(self, param: object) -> None:
        """The port is read when the mount is opened."""

    def close(self) -> None:
        """Motors off, port closed."""
        if self.controller and self.is_master:
            try:
                self.controller.close()
            except MountError as e:
                self.emit_status(str(e))

    @property
    def _axis(self):
        return self.controller.axis(self.axis_name)


if __name__ == "__main__":
    main(__file__)
