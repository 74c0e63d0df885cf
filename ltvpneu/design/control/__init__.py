"""Feedback through the valves: models from period to period, controllers, and the loop closed on the machine."""
