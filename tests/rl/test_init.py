"""What ``import rl`` offers."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

import rl


@pytest.mark.parametrize("name", rl.__all__)
def test_a_name_of_the_package_is_there(name):
    assert getattr(rl, name) is not None


def test_an_unknown_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match="no attribute 'NavEnw'"):
        _ = rl.NavEnw


def test_importing_the_package_does_not_import_torch():
    code = "import sys, rl; print('torch' in sys.modules)"
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=Path(__file__).parents[2]
    )
    assert done.stdout.strip() == "False"
