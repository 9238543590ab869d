"""The DSP: kinematics, trajectories, position control, the cycle."""
