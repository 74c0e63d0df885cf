"""Design on the linear models; loads cvxpy."""

from ltvpneu.design.air_use import air_use, with_air_use
from ltvpneu.design.certificate import Certificate, common_lyapunov
from ltvpneu.design.control.closed_loop import ClosedLoop, simulate_closed_loop
from ltvpneu.design.control.duty_model import duty_model
from ltvpneu.design.control.laws import Measurement, Sensor
from ltvpneu.design.control.position_controller import PositionController
from ltvpneu.design.control.slide_controller import SlideController
from ltvpneu.design.duty_map import DutyMap, duty_map
from ltvpneu.design.forcing.forcing import ForcingProblem, ForcingSolution, forcing_problem
from ltvpneu.design.moves.expressions import Move
from ltvpneu.design.moves.optimize import optimize_move
from ltvpneu.design.moves.solution import MoveSolution
from ltvpneu.design.moves.switched_linear import SwitchingSolution, optimize_switching
from ltvpneu.design.operating_box import operating_box
from ltvpneu.design.pattern.pattern import PatternSolution, optimize_pattern
from ltvpneu.design.sizing import Sized, Sizing, size
from ltvpneu.design.stability_map import Box, StabilityMap, stability_map
from ltvpneu.design.switching.cycle import LinearizedCycle
from ltvpneu.design.switching.duty_problem import DutyProblem, duty_problem
from ltvpneu.design.switching.duty_solution import Chosen, DutySolution, GoalCheck
from ltvpneu.design.switching.goals import Goals
from ltvpneu.design.switching.optimize import optimize_duty
from ltvpneu.design.switching.tolerances import check_goals
from ltvpneu.design.switching.trade_off import TradeOff, trade_off
from ltvpneu.design.valve_limits import ValveLimits

__all__ = [
    "Box",
    "Certificate",
    "Chosen",
    "ClosedLoop",
    "DutyMap",
    "DutyProblem",
    "DutySolution",
    "ForcingProblem",
    "ForcingSolution",
    "GoalCheck",
    "Goals",
    "LinearizedCycle",
    "Measurement",
    "Move",
    "MoveSolution",
    "PatternSolution",
    "PositionController",
    "Sensor",
    "Sized",
    "Sizing",
    "SlideController",
    "StabilityMap",
    "SwitchingSolution",
    "TradeOff",
    "ValveLimits",
    "air_use",
    "check_goals",
    "common_lyapunov",
    "duty_map",
    "duty_model",
    "duty_problem",
    "forcing_problem",
    "operating_box",
    "optimize_duty",
    "optimize_move",
    "optimize_pattern",
    "optimize_switching",
    "simulate_closed_loop",
    "size",
    "stability_map",
    "trade_off",
    "with_air_use",
]
