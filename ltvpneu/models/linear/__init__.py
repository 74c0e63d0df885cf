"""The linear models: where they are linearized, about what, how they are marched, and how far off they are."""
