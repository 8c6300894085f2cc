"""The driver `hubo_motor`: one board of 1, 2, 3 or 5 motors. See `core` for what is sent and heard, and the other modules
for what can be done.

1. A board lists only the actions that its kind and dialect have.
"""

from __future__ import annotations

from .compliance import CompliantMode
from .homing import Homing

_ALWAYS = {
    "enable": "follow set-points, from where the joints are",
    "disable": "control off, drivers off",
    "stop_motion": "control off, at once; set-points are forgotten",
}
_GAINS = {"set_gains": "position gains of a joint, kp= ki= kd=, or torque=True"}
_HOME = {"home": "search the home of a joint, or of all; it moves"}
_ZERO = {"zero_encoder": "make the present position the encoder's zero"}
_MODE = {"set_control_mode": "position, current or torque, hybrid"}
_D12 = {
    "clear_errors": "clear error bits; also sets the encoder to zero",
    "parameters": "read all that is stored in the board",
    "set_parameters": "write stored parameters of a joint or the board, name=value",
    "set_limits": "the board's own position limits, lower= upper= (rad)",
    "override_gains": "scale the gains of the first two motors, in %",
    "switching_mode": "free_wheeling=True: the motor turns freely",
    "beep": "beep for some seconds",
    "alarm": "alarm sound 1 to 4; 0 is silence",
    "initialise": "load the board's defaults, confirm=True; its calibration is lost",
    "set_board_number": "give the board another number, confirm=True",
}
_INFO = {"board_info": "ask the board what it is; tells it its period"}
_COMPLIANCE = {"set_compliance": "let the joints give way (on), or be rigid again (off)"}


class HuboMotor(Homing, CompliantMode):
    """One motor board."""

    asking = ("parameters",)

    def setup(self) -> None:
        """As declared in `shapes`; the actions that this board has."""
        super().setup()
        shape = self.shape
        actions = dict(_ALWAYS)
        if shape.gains:
            actions |= _GAINS | _MODE
        if shape.home is not None:
            actions |= _HOME
        if shape.encoders and self.kind != "neck":
            actions |= _ZERO
        if self.dialect == "D12" and self.kind != "neck":
            actions |= _D12
        if self.knows_name():
            actions |= _INFO
        soft = [axis.joint.compliance is not None for axis in self.axes if axis.joint is not None]
        if (
            self.dialect == "D12"
            and self.kind in (1, 2)
            and soft
            and all(soft)
            and self.set_message == "Reference"
        ):
            actions |= _COMPLIANCE
        self.actions = actions  # type: ignore[misc]
