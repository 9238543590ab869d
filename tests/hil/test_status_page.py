"""The status page: what is read was published as a whole, whoever writes at the same time."""

import os
import subprocess
import sys

from hil.wire.status_page import Status, StatusPage, make_file

WRITER = """
import sys
from hil.wire.status_page import Status, StatusPage
page = StatusPage(int(sys.argv[1]))
for n in range(1, 200_001):
    page.write(Status(n, n, n, n & 0xFF, n & 0xFFFF, n & 0xFFFF))
"""


def test_what_is_read_is_what_was_published() -> None:
    descriptor = make_file()
    page, other = StatusPage(descriptor), StatusPage(descriptor)
    assert other.read() == Status(0, 0, 0, 0, 0, 0)
    page.write(Status(1, 2, 3, 2, 255, 127))
    assert other.read() == Status(1, 2, 3, 2, 255, 127)
    os.close(descriptor)
    page.close()
    other.close()


def test_writer_that_died_in_the_middle_holds_nobody(monkeypatch) -> None:
    monkeypatch.setattr("hil.wire.status_page.TRIES", 10)
    descriptor = make_file()
    page = StatusPage(descriptor)
    page.write(Status(1, 2, 3, 1, 0, 0))
    os.pwrite(descriptor, b"\x03", 0)  # an odd number: somebody writes
    assert page.read() == Status(1, 2, 3, 1, 0, 0)
    os.close(descriptor)
    page.close()


def test_no_half_of_an_update_is_ever_seen() -> None:
    """Another process writes all fields alike; a reader that looks all the while must find them alike."""
    descriptor = make_file()
    page = StatusPage(descriptor)
    writer = subprocess.Popen([sys.executable, "-c", WRITER, str(descriptor)], pass_fds=[descriptor])
    last, looks = 0, 0
    while last < 200_000 and (looks == 0 or writer.poll() in (None, 0)):
        status = page.read()
        last = status.heard
        assert status == (last, last, last, last & 0xFF, last & 0xFFFF, last & 0xFFFF)
        looks += 1
    assert writer.wait() == 0
    assert looks > 0
    os.close(descriptor)
    page.close()
