"""Control design for pneumatic actuators switched by on-off valves, on python-control."""

from ltvpneu.errors import (
    CavitationError,
    ChamberVolumeError,
    GasRangeError,
    IntegrationError,
    LtvpneuError,
    MachineFileError,
    NonUniqueOrbitError,
    NoOrbitError,
    NotConvergedError,
    NotConvexError,
    NotSettledError,
    NotStabilizableError,
    NotStableError,
    SkippedStepError,
    SolverError,
    StepOverflowError,
)
from ltvpneu.face.machine_file import load_machine
from ltvpneu.face.plots import plot
from ltvpneu.models.cycles.amplitude import AmplitudeResponse, amplitude_response
from ltvpneu.models.cycles.floquet import cycle_floquet
from ltvpneu.models.cycles.orbit_map import Branch, OrbitMap, orbit_map
from ltvpneu.models.cycles.sensitivity import ParameterSensitivity, nonlinear_sensitivity, parameter_sensitivity
from ltvpneu.models.cycles.validity_map import ValidityMap, validity_map
from ltvpneu.models.linear.error_estimate import ErrorEstimate
from ltvpneu.models.linear.linearize import Linearization, linearize
from ltvpneu.models.linear.lti import lti_model
from ltvpneu.models.linear.ltv import ltv_model
from ltvpneu.models.linear.model import LtvModel
from ltvpneu.models.machine.connections import FlowPath
from ltvpneu.models.machine.machine import Machine
from ltvpneu.models.nonlinear.attractors import Attractors, attractors
from ltvpneu.models.nonlinear.balance import Balance, balance
from ltvpneu.models.nonlinear.failed_point import FailedPoint
from ltvpneu.models.nonlinear.floquet import orbit_floquet
from ltvpneu.models.nonlinear.simulation import DormandPrince, RungeKutta4, nonlinear_orbit, simulate
from ltvpneu.models.nonlinear.stiction_band import StictionBand, stiction_band
from ltvpneu.periodic.floquet import Floquet, floquet, monodromy
from ltvpneu.periodic.gramians import Gramians, gramians
from ltvpneu.periodic.harmonic import frequency_response, harmonic_transfer
from ltvpneu.periodic.hinf import hinf_norm
from ltvpneu.periodic.interconnect import feedback, parallel, series, state_feedback
from ltvpneu.periodic.iosys import to_iosys
from ltvpneu.periodic.lifted import averaged, lifted
from ltvpneu.periodic.lyapunov import lyapunov, lyapunov_factors
from ltvpneu.periodic.norms import h2_norm, hankel_norm
from ltvpneu.periodic.orbit import Orbit
from ltvpneu.periodic.product import ProductMultipliers, product_multipliers
from ltvpneu.periodic.ramps import ramped
from ltvpneu.periodic.response import response
from ltvpneu.periodic.riccati import Estimator, Regulator, kalman, lqr
from ltvpneu.periodic.sensitivity import Gradient, Sensitivity, sensitivity
from ltvpneu.periodic.steady import steady_state
from ltvpneu.periodic.switching import SwitchAware
from ltvpneu.periodic.system import PeriodicSystem, Step
from ltvpneu.periodic.variation import Variation
from ltvpneu.physics.cylinder import Cylinder
from ltvpneu.physics.gas import Gas
from ltvpneu.physics.inner_volume import InnerVolume
from ltvpneu.physics.liquid import Liquid
from ltvpneu.physics.load import Load
from ltvpneu.physics.profile import Profile
from ltvpneu.physics.proportional import Command, ProportionalValve
from ltvpneu.physics.real_gas import RealGas
from ltvpneu.physics.thermal import EnergyBalance
from ltvpneu.physics.valve import OnOffValve, Port, RotaryValve
from ltvpneu.physics.window import Window

__version__ = "0.1.0"

__all__ = [
    "AmplitudeResponse",
    "Attractors",
    "Balance",
    "Branch",
    "CavitationError",
    "ChamberVolumeError",
    "Command",
    "Cylinder",
    "DormandPrince",
    "EnergyBalance",
    "ErrorEstimate",
    "Estimator",
    "FailedPoint",
    "Floquet",
    "FlowPath",
    "Gas",
    "GasRangeError",
    "Gradient",
    "Gramians",
    "InnerVolume",
    "IntegrationError",
    "Linearization",
    "Liquid",
    "Load",
    "LtvModel",
    "LtvpneuError",
    "Machine",
    "MachineFileError",
    "NoOrbitError",
    "NonUniqueOrbitError",
    "NotConvergedError",
    "NotConvexError",
    "NotSettledError",
    "NotStabilizableError",
    "NotStableError",
    "OnOffValve",
    "Orbit",
    "OrbitMap",
    "ParameterSensitivity",
    "PeriodicSystem",
    "Port",
    "ProductMultipliers",
    "Profile",
    "ProportionalValve",
    "RealGas",
    "Regulator",
    "RotaryValve",
    "RungeKutta4",
    "Sensitivity",
    "SkippedStepError",
    "SolverError",
    "Step",
    "StepOverflowError",
    "StictionBand",
    "SwitchAware",
    "ValidityMap",
    "Variation",
    "Window",
    "amplitude_response",
    "attractors",
    "averaged",
    "balance",
    "cycle_floquet",
    "feedback",
    "floquet",
    "frequency_response",
    "gramians",
    "h2_norm",
    "hankel_norm",
    "harmonic_transfer",
    "hinf_norm",
    "kalman",
    "lifted",
    "linearize",
    "load_machine",
    "lqr",
    "lti_model",
    "ltv_model",
    "lyapunov",
    "lyapunov_factors",
    "monodromy",
    "nonlinear_orbit",
    "nonlinear_sensitivity",
    "orbit_floquet",
    "orbit_map",
    "parallel",
    "parameter_sensitivity",
    "plot",
    "product_multipliers",
    "ramped",
    "response",
    "sensitivity",
    "series",
    "simulate",
    "state_feedback",
    "steady_state",
    "stiction_band",
    "to_iosys",
    "validity_map",
]
