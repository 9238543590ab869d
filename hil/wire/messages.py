"""python-can's messages, and the bus's frames: one number for the kind, and data."""

import can

from hil.wire.identifier import (
    BRS,
    ERROR,
    ESI,
    EXTENDED,
    EXTENDED_MASK,
    FD,
    OWN,
    REMOTE,
    STANDARD_MASK,
    refusal,
    split_identifier,
)


def to_message(end_ns: int, identifier: int, data: bytes, channel: str | None = None) -> can.Message:
    """Return a frame as python-can's message; the timestamp is virtual time in s."""
    if identifier & ERROR:
        return _error_message(end_ns, identifier, data, channel)
    number, extended, remote = split_identifier(identifier)
    return can.Message(
        timestamp=end_ns * 1e-9,
        arbitration_id=number,
        is_extended_id=extended,
        is_remote_frame=remote,
        is_fd=identifier & FD != 0,
        bitrate_switch=identifier & BRS != 0,
        error_state_indicator=identifier & ESI != 0,
        dlc=len(data),
        data=None if remote else data,
        channel=channel,
        is_rx=identifier & OWN == 0,
    )


def _error_message(end_ns: int, identifier: int, data: bytes, channel: str | None) -> can.Message:
    return can.Message(
        timestamp=end_ns * 1e-9,
        arbitration_id=identifier & EXTENDED_MASK,
        is_extended_id=False,
        is_error_frame=True,
        dlc=len(data),
        data=data,
        channel=channel,
    )


def to_frame(message: can.Message, fd: bool) -> tuple[int, bytes]:
    """Return a message as (identifier with flags, data); raise can.CanOperationError for what cannot be sent.

    fd: whether FD frames can be. A remote frame's data stand for its DLC.
    """
    if message.is_error_frame:
        raise can.CanOperationError("an error frame cannot be sent: controllers make them")
    number, extended = message.arbitration_id, message.is_extended_id
    if not 0 <= number <= (EXTENDED_MASK if extended else STANDARD_MASK):
        raise can.CanOperationError(f"identifier {number:#x} has more than {29 if extended else 11} bits")
    identifier = number | EXTENDED * extended | REMOTE * message.is_remote_frame
    if message.is_fd:
        identifier |= FD | BRS * message.bitrate_switch | ESI * message.error_state_indicator
    data = bytes(message.dlc) if message.is_remote_frame else bytes(message.data)
    if not message.is_remote_frame and len(data) != message.dlc:
        raise can.CanOperationError(f"dlc = {message.dlc} with {len(data)} bytes of data: make them equal")
    reason = refusal(identifier, len(data), fd)
    if reason:
        raise can.CanOperationError(reason)
    return identifier, data
