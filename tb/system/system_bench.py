# SPDX-License-Identifier: Apache-2.0
"""The command as a user calls it, and a look at which processes are left."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

from dermis.records import Plan
from dermis.scene.design import ROOT

MakePlan = Callable[..., Plan]
FaultyChip = Callable[[str, str, str], None]


def dermis(*arguments: str, limit_s: float = 120, **options: object) -> subprocess.CompletedProcess[str]:
    """Call the command line in a process of its own."""
    command = [sys.executable, "-m", "dermis", *arguments]
    return subprocess.run(
        command, capture_output=True, text=True, timeout=limit_s, check=False, cwd=ROOT, **options
    )


def processes_with(text: str) -> list[int]:
    """Processes, other than this one, whose command or environment holds a text."""
    found = []
    for entry in Path("/proc").iterdir():
        if not entry.name.isdigit() or int(entry.name) == os.getpid():
            continue
        try:
            said = (entry / "cmdline").read_bytes() + (entry / "environ").read_bytes()
            state = (entry / "stat").read_text().rsplit(")", 1)[1].split()[0]
        # The process has ended meanwhile.
        except OSError:
            continue
        if text.encode() in said and state != "Z":
            found.append(int(entry.name))
    return found
