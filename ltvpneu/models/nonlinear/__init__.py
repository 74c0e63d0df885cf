"""The nonlinear model: one turn, settled and judged."""
