"""Programs that are killed at work."""

import subprocess
import sys
import time
from pathlib import Path

import mrs

# A child has mrs.output without the rest of mrs, which takes a second to import.
PRELUDE = f"""
import sys, types
mrs = types.ModuleType("mrs")
mrs.__path__ = [{str(Path(mrs.__file__).parent)!r}]
sys.modules["mrs"] = mrs
import numpy as np
"""


def kill_at_random(program, path, rng):
    """Run a program that reports what it has done, kill it, and return its last report."""
    command = [sys.executable, "-c", PRELUDE + program, str(path)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as child:
        reports = [child.stdout.readline() for _ in range(rng.integers(1, 6))]
        time.sleep(rng.random() * 0.03)
        child.kill()
        reports += child.stdout.readlines()
    whole = [line for line in reports if line.endswith("\n")]
    return int(whole[-1])
