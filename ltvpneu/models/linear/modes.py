"""Names of what an LTV model is linearized about."""

from typing import Literal, get_args

OperatingPoints = Literal[
    "lti", "lti-position", "mean", "quasi-static", "quasi-static-steps", "fitted", "self-consistent"
]
MODES: tuple[OperatingPoints, ...] = get_args(OperatingPoints)
