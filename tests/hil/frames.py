"""Messages that tests of the python-can interface send."""

import can


def standard(identifier, *data):
    """A frame with an 11-bit identifier."""
    return can.Message(arbitration_id=identifier, is_extended_id=False, data=data)
