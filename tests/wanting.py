"""What a test needs and this machine has not: the test is skipped, and says so; under CI it fails."""

import os
from typing import NoReturn

import pytest


def wanting(text: str) -> NoReturn:
    """Skip or fail the calling test for that reason."""
    if os.environ.get("HIL_LAB") == "1":
        pytest.fail(text)
    pytest.skip(text)
