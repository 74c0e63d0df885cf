"""Control design for pneumatic actuators switched by on-off valves, on python-control."""

from ltvpneu.errors import (
    ChamberVolumeError,
    IntegrationError,
    LtvpneuError,
    MachineFileError,
    NonUniqueOrbitError,
    NoOrbitError,
    NotSettledError,
    StepOverflowError,
)
from ltvpneu.face.machine_file import load_machine
from ltvpneu.face.plots import plot
from ltvpneu.models.amplitude import AmplitudeResponse, amplitude_response
from ltvpneu.models.linearize import Linearization, LtvModel, linearize
from ltvpneu.models.lti import lti_model
from ltvpneu.models.ltv import ltv_model
from ltvpneu.models.machine import FlowPath, Machine
from ltvpneu.models.nonlinear import DormandPrince, RungeKutta4, nonlinear_orbit, simulate
from ltvpneu.periodic.floquet import Floquet, floquet, monodromy
from ltvpneu.periodic.orbit import Orbit
from ltvpneu.periodic.response import response
from ltvpneu.periodic.steady import steady_state
from ltvpneu.periodic.system import PeriodicSystem, Step
from ltvpneu.physics.cylinder import Cylinder
from ltvpneu.physics.gas import Gas
from ltvpneu.physics.load import Load
from ltvpneu.physics.valve import OnOffValve, Port, Profile, RotaryValve, Window

__version__ = "0.1.0"

__all__ = [
    "AmplitudeResponse",
    "ChamberVolumeError",
    "Cylinder",
    "DormandPrince",
    "Floquet",
    "FlowPath",
    "Gas",
    "IntegrationError",
    "Linearization",
    "Load",
    "LtvModel",
    "LtvpneuError",
    "Machine",
    "MachineFileError",
    "NoOrbitError",
    "NonUniqueOrbitError",
    "NotSettledError",
    "OnOffValve",
    "Orbit",
    "PeriodicSystem",
    "Port",
    "Profile",
    "RotaryValve",
    "RungeKutta4",
    "Step",
    "StepOverflowError",
    "Window",
    "amplitude_response",
    "floquet",
    "linearize",
    "load_machine",
    "lti_model",
    "ltv_model",
    "monodromy",
    "nonlinear_orbit",
    "plot",
    "response",
    "simulate",
    "steady_state",
]
