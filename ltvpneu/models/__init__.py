"""Physics turned into systems: one machine, three models."""
