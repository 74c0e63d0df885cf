"""Design on the linear models; loads cvxpy."""

from ltvpneu.design.air_use import air_use, with_air_use
from ltvpneu.design.certificate import Certificate, common_lyapunov, operating_box
from ltvpneu.design.forcing import ForcingProblem, ForcingSolution, forcing_problem

__all__ = [
    "Certificate",
    "ForcingProblem",
    "ForcingSolution",
    "air_use",
    "common_lyapunov",
    "forcing_problem",
    "operating_box",
    "with_air_use",
]
