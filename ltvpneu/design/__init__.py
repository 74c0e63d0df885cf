"""Design on the linear models; loads cvxpy."""

from ltvpneu.design.air_use import air_use, with_air_use
from ltvpneu.design.forcing import ForcingProblem, ForcingSolution, forcing_problem

__all__ = ["ForcingProblem", "ForcingSolution", "air_use", "forcing_problem", "with_air_use"]
