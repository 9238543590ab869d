"""The robot: rigid bodies, friction, drives, brakes, encoders, payload. Knows no bus, no process and no clock."""
