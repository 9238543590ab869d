"""One joint's 16-bit CPU: its control step, its state machine, its parameters."""
