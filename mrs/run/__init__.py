"""Runs: the simulation, its scenario, going on, looking at it, and the command `mrs`."""
