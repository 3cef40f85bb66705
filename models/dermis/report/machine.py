# SPDX-License-Identifier: Apache-2.0
"""Description of the machine that a result was measured on."""

from __future__ import annotations

import os
import platform
import re
from pathlib import Path

from dermis.report import output


def machine_line() -> str:
    """Return processor, system and versions in one line."""
    cpu = re.search(r"^model name\s*:\s*(.+)$", Path("/proc/cpuinfo").read_text(), re.MULTILINE)
    system = platform.freedesktop_os_release().get("PRETTY_NAME", platform.system())
    found = {name: re.search(r"\d[\w.]*", said) for name, said in output.versions().items()}
    versions = ", ".join(f"{name} {number[0] if number else 'missing'}" for name, number in found.items())
    return f"{cpu[1].strip() if cpu else platform.machine()}, {os.cpu_count()} cores, {system}; {versions}"
