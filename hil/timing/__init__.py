"""Timing of a CAN bus: worst-case response times, and whether every message meets its deadline."""
