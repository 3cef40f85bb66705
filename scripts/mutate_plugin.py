# SPDX-License-Identifier: Apache-2.0
"""Plugin for pytest: tests of tb/rtl build a mutated copy of rtl/, with files outside build/rtl."""

import os
from pathlib import Path

from dermis.chip import hdl, sources
from dermis.scene.design import ROOT

TREE = Path(os.environ["DERMIS_MUTANT_RTL"])
WORK = Path(os.environ["DERMIS_MUTANT_WORK"])

_sources = sources.rtl_sources


def _mutated(root: Path = ROOT) -> list[Path]:
    return [TREE / path.name for path in _sources(root)]


# Before a test imports them by name.
sources.rtl_sources = _mutated
hdl.rtl_sources = _mutated
hdl.BUILD = WORK / "build"
