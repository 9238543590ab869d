"""Sweeps: a scenario run at many points of its parameters, over any executor, into one table that can go on."""
