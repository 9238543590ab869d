"""The rig's calls of a node, through stdin and stdout: a call is CALL, its answer HEAD and what belongs to it.

A frame that the joint stores has no answer. The end of stdin is the end.
"""

import json
import struct
import sys

START, FRAME, TIMER, REPORT, REACTION = range(0x80, 0x85)
"""Of calls and answers; bytes with which no text begins."""
CALL = "<BBHq8s"
"""Kind, length, identifier, now in ns, data."""
HEAD = "<BBHqq"
"""REACTION or REPORT, finished, bytes that follow, computing time in ns, next timer in ns or NO_TIMER."""
SEND = "<qHB8s"
"""Delay in ns, identifier, length, data."""
NO_TIMER = -(1 << 63)


def serve(joint):
    """Answer calls until there are no more."""
    size = struct.calcsize(CALL)
    calls, answers = sys.stdin.buffer, sys.stdout.buffer
    while len(call := calls.read(size)) == size:
        answers.write(answer(joint, *struct.unpack(CALL, call)))


def answer(joint, kind, length, identifier, now_ns, data):
    """Have the joint called; return the answer, nothing where there is none."""
    if kind == FRAME and identifier in joint.stores:
        joint.store(identifier, data[:length], now_ns)
        return b""
    if kind == REPORT:
        text = json.dumps(joint.report()).encode()
        return struct.pack(HEAD, REPORT, joint.finished, len(text), 0, 0) + text
    if kind == FRAME:
        reaction = joint.on_frame(identifier, data[:length], now_ns)
    else:
        reaction = (joint.on_timer if kind == TIMER else joint.on_start)(now_ns)
    busy_ns, timer_ns, sends = reaction
    timer_ns = NO_TIMER if timer_ns is None else timer_ns
    frames = b"".join([struct.pack(SEND, ns, number, len(frame), frame) for ns, number, frame in sends])
    return struct.pack(HEAD, REACTION, joint.finished, len(frames), busy_ns, timer_ns) + frames
