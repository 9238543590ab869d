"""What docs/board.md shows of the database and of a run, made anew.

`python -m tests.examples.board_page` writes it into the page.
"""

import re
from importlib.resources import as_file, files
from pathlib import Path

from cantools.database import load_file

from dbc.compiler import load_arm
from firmware_py.joint_cpu import PARAMETERS_NAMES, SIGNALS, make_step
from firmware_py.words import InstrumentedWords
from tests.examples.test_joint_c import record
from tests.examples.transcript import CALL

PAGE = Path(__file__).parents[2] / "docs" / "board.md"
NODE = "JOINT2"
T_NS = 1_000_000
SHOWN = 700
"""The cycle whose step the page shows in numbers."""


def block(name):
    """Return the pattern of a generated part of the page."""
    return re.compile(rf"(<!-- generated: {name} -->\n).*?(<!-- end -->)", re.S)


def with_blocks(text):
    """Return the page with all its generated parts made anew."""
    for name, make in {"frames": frames, "set-up": set_up, "run": beginning, "step": step}.items():
        around = block(name).search(text)
        text = text[: around.end(1)] + make() + text[around.start(2) :]
    return text


# -- from the database --


def frames():
    """A table of bytes for every frame that joint 2 sends or gets."""
    with as_file(files("dbc") / "arm.dbc") as path:
        messages = load_file(path, database_format="dbc").messages
    ours = [each for each in messages if NODE in each.senders or NODE in each.receivers]
    return "".join(frame(message) for message in sorted(ours, key=lambda message: message.frame_id))


def frame(message):
    way = (
        "sent"
        if message.senders == [NODE]
        else f"from {message.senders[0]}"
        if len(message.senders) == 1
        else "from anybody"
    )
    size = "1 byte" if message.length == 1 else f"{message.length} bytes"
    cycle = f", every {message.cycle_time} ms" if message.cycle_time else ""
    lines = [
        f"**{message.name}**, 0x{message.frame_id:03X}, {size}, {way}{cycle}. {message.comment}\n",
        "| bytes | signal | type | a count is | meaning |",
        "| --- | --- | --- | --- | --- |",
        *(row(signal) for signal in sorted(message.signals, key=lambda signal: signal.start)),
    ]
    return "\n".join(lines) + "\n\n"


def row(signal):
    first, last = signal.start // 8, (signal.start + signal.length) // 8 - 1
    kind = f"{'i' if signal.is_signed else 'u'}{signal.length}"
    unit = "-" if signal.unit in ("-", "count", "cycle") else f"{signal.scale:.10g} {signal.unit}"
    choices = "".join(f"; {value} {name}" for value, name in (signal.choices or {}).items())
    where = str(first) if first == last else f"{first}-{last}"
    return f"| {where} | {signal.name} | {kind} | {unit} | {signal.comment.rstrip('.')}{choices} |"


# -- from a run --


def transcript():
    """Joint 2 of paper-joint: (cycle, name, identifier, data, what it means), what came and what went, in order."""
    codec = load_arm()
    _, (_, joint, _) = record("paper-joint")
    reactions = iter(joint.reactions)
    for call in joint.calls[1:]:
        _, length, _, _, identifier, now_ns, data, _, _ = CALL.unpack(call)
        said = [(identifier, data[:length])]
        if call[:1] == b"f":
            said += [(answer, answered) for _, answer, answered in next(reactions)[2]]
        for number, payload in said:
            message = codec.by_identifier[number]
            yield now_ns // T_NS, message, payload, dict(zip(message.signals, message.unpack(payload), strict=True))


def line(cycle, message, data, note):
    return (
        f"{cycle:5}  {message.identifier:03X}  {message.name:<13}  {data.hex(' ').upper():<23}  {note}".rstrip() + "\n"
    )


def set_up():
    """Parameters and their acknowledgements."""
    names = [*PARAMETERS_NAMES, "CRC-16"]
    lines = "cycle   id  frame          data\n"
    for cycle, message, data, fields in transcript():
        if message.name in ("Parameter_2", "Acknowledge_2"):
            value = fields["Value"]
            shown = f"0x{value & 0xFFFF:04X}" if fields["Index"] == len(PARAMETERS_NAMES) else str(value)
            check = f", table CRC-16 0x{fields['TableCrc']:04X}" if "TableCrc" in fields else ""
            lines += line(cycle, message, data, f"{names[fields['Index']]} = {shown}{check}")
    return f"```text\n{lines}```\n"


def beginning():
    """All that joint 2 gets and sends in cycles -2 to 2."""
    lines = "cycle   id  frame          data\n"
    for cycle, message, data, fields in transcript():
        if -2 <= cycle <= 2:
            note = ", ".join(f"{name} {value}" for name, value in fields.items() if name != "Cycle")
            lines += line(cycle, message, data, note)
    return f"```text\n{lines}```\n"


def step():
    """One step of the law in numbers."""
    values = dict.fromkeys(("count", "count_prev", "w_prev", "d", "a_ref"), 0)
    table = None
    for cycle, message, _, fields in transcript():
        if message.name == "Acknowledge_2" and cycle < 0:
            table = [*(table or [0] * 5)]
            table[min(fields["Index"], 4)] = fields["Value"] if fields["Index"] < 5 else table[4]
        elif message.name == "AccelRef":
            values["a_ref"] = fields["Joint2"]
        elif message.name == "Encoder_2" and cycle >= 0:
            values["count"] = fields["Position"]
            if cycle == 0:
                values["count_prev"] = fields["Position"]
            words = InstrumentedWords(16, len(SIGNALS))
            before = dict(values)
            w, d, i, estimate = make_step(InstrumentedWords)(words, *values.values(), *table)
            values |= {"count_prev": fields["Position"], "w_prev": w, "d": d}
            if cycle == SHOWN:
                break
    pull = words.minimum[2]
    lines = [
        f"before      {', '.join(f'{name} = {value}' for name, value in before.items())}",
        f"parameters  {', '.join(f'{name} = {value}' for name, value in zip(PARAMETERS_NAMES, table, strict=True))}",
        f"w   = {w}",
        f"dw  = {words.minimum[1]}",
        f"d   = {before['d'] - (pull << 16)}, KB dw = {pull}",
        f"e   = {estimate}",
        f"i   = {i}",
        f"d   = {d}, i - e = {words.minimum[5]}",
    ]
    return "```text\n" + "\n".join(lines) + "\n```\n"


if __name__ == "__main__":
    PAGE.write_text(with_blocks(PAGE.read_text()))
