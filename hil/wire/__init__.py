"""A CAN bus in virtual time."""
